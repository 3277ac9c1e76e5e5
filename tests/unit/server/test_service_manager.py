# SPDX-License-Identifier: Apache-2.0
"""What systemd receives, read from the other end of its socket, and the lines that are for its journal."""

from __future__ import annotations

import io
import logging
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_thread import daemon

from cm.cli.serve import Lines, _is_journal
from cm.server.systemd import ServiceManager


@pytest.fixture
def inbox(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "socket"))
        sock.settimeout(60)
        yield sock


def test_messages_are_those_of_sd_notify(inbox: socket.socket) -> None:
    service = ServiceManager({"NOTIFY_SOCKET": inbox.getsockname()})
    service.ready()
    service.alive()
    service.reloading()
    service.stopping()
    assert [inbox.recv(1000) for _ in range(2)] == [b"READY=1", b"WATCHDOG=1"]
    first, second = inbox.recv(1000).split(b"\n")
    name, _, microseconds = second.partition(b"=")
    assert (first, name) == (b"RELOADING=1", b"MONOTONIC_USEC")
    assert 0 <= time.monotonic_ns() // 1000 - int(microseconds) < 60_000_000
    assert inbox.recv(1000) == b"STOPPING=1"


def test_the_address_may_be_in_the_abstract_namespace() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        name = f"cm-test-{os.getpid()}"
        sock.bind("\0" + name)
        sock.settimeout(60)
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).ready()
        assert sock.recv(100) == b"READY=1"


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({"WATCHDOG_USEC": "3000000"}, 1.5),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}, 1.5),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "3000000", "NOTIFY_SOCKET": ""}, None),
        ({}, None),
    ],
)
def test_signs_of_life_come_twice_as_often_as_they_are_waited_for(
    environment: dict[str, str], seconds: float | None
) -> None:
    assert ServiceManager({"NOTIFY_SOCKET": "/nowhere", **environment}).interval == seconds


def test_a_daemon_says_when_it_is_ready_that_it_lives_and_that_it_ends(
    inbox: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", inbox.getsockname())
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    with daemon():
        assert [inbox.recv(1000) for _ in range(2)] == [b"READY=1", b"WATCHDOG=1"]
    while (said := inbox.recv(1000)) == b"WATCHDOG=1":
        pass
    assert said == b"STOPPING=1"


def test_a_service_manager_that_is_gone_does_no_harm(tmp_path: Path) -> None:
    ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "none")}).ready()


@pytest.mark.parametrize(
    ("level", "priority"), [(50, 2), (49, 3), (40, 3), (30, 4), (29, 6), (20, 6), (19, 7), (10, 7), (1, 7)]
)
def test_each_line_for_the_journal_begins_with_its_priority_and_none_can_be_forged(level: int, priority: int) -> None:
    record = logging.LogRecord("cm", level, "", 1, "one\n<0>two", (), None)
    assert Lines(journal=True).format(record) == f"<{priority}>one\n<{priority}>    <0>two"


def test_records_are_for_the_journal_only_if_stderr_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (tmp_path / "stream").open("w") as stream:
        own = os.fstat(stream.fileno())
        for said, file, journal in (
            (f"{own.st_dev}:{own.st_ino}", stream, True),
            (f"{own.st_dev}:{own.st_ino + 1}", stream, False),
            (f"{own.st_dev}:{own.st_ino}", io.StringIO(), False),  # has no descriptor
        ):
            monkeypatch.setenv("JOURNAL_STREAM", said)
            monkeypatch.setattr(sys, "stderr", file)
            assert _is_journal() is journal

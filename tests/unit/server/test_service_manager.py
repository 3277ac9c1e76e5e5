# SPDX-License-Identifier: Apache-2.0
"""What systemd and journald receive, read from the other end of their sockets."""

from __future__ import annotations

import io
import logging
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_thread import daemon

from cm.server.systemd import JournalHandler, ServiceManager, journal_handler


@pytest.fixture
def inbox(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "socket"))
        sock.settimeout(60)
        yield sock


def test_messages_are_those_of_sd_notify(inbox: socket.socket) -> None:
    service = ServiceManager({"NOTIFY_SOCKET": inbox.getsockname()})
    service.ready()
    service.ready("two boards")
    service.alive()
    service.reloading()
    service.stopping()
    assert [inbox.recv(1000) for _ in range(3)] == [b"READY=1", b"READY=1\nSTATUS=two boards", b"WATCHDOG=1"]
    first, second = inbox.recv(1000).split(b"\n")
    name, _, microseconds = second.partition(b"=")
    assert (first, name) == (b"RELOADING=1", b"MONOTONIC_USEC")
    assert 0 <= time.monotonic_ns() // 1000 - int(microseconds) < 60_000_000
    assert inbox.recv(1000) == b"STOPPING=1"
    assert (service.present, ServiceManager({}).present) == (True, False)


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


def _logged(inbox: socket.socket, message: str, **extra: object) -> bytes:
    handler = JournalHandler(inbox.getsockname())
    logger = logging.Logger("test")
    logger.addHandler(handler)
    logger.warning(message, extra=extra)
    handler.close()
    return inbox.recv(10000)


def test_a_record_has_fields_for_its_code_and_its_change(inbox: socket.socket) -> None:
    fields = [b"MESSAGE=refused", b"PRIORITY=4", b"SYSLOG_IDENTIFIER=cm", b"CODE_FUNC=_logged"]
    for extra, more in (
        ({"cm_code": "busy", "cm_change": 7}, [b"CM_CODE=busy", b"CM_CHANGE=7"]),
        ({"cm_code": "", "cm_change": None}, []),
    ):
        assert _logged(inbox, "refused", **extra).split(b"\n") == [*fields, *more, b""]


@pytest.mark.parametrize(
    ("level", "priority"), [(50, 2), (49, 3), (40, 3), (30, 4), (29, 6), (20, 6), (19, 7), (10, 7), (1, 7)]
)
def test_levels_are_those_of_syslog(inbox: socket.socket, level: int, priority: int) -> None:
    handler = JournalHandler(inbox.getsockname())
    handler.emit(logging.LogRecord("cm", level, "", 1, "x", (), None))
    handler.close()
    assert b"PRIORITY=%d\n" % priority in inbox.recv(1000)


def test_a_journal_that_takes_nothing_costs_only_the_record(
    inbox: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed: list[logging.LogRecord] = []
    monkeypatch.setattr(logging.Handler, "handleError", lambda _, record: failed.append(record))
    handler, record = JournalHandler(str(tmp_path / "none")), logging.LogRecord("cm", 30, "", 1, "x", (), None)
    handler.emit(record)
    handler.close()
    assert failed == [record]


def test_a_message_of_several_lines_travels_with_its_length(inbox: socket.socket) -> None:
    text = b"one\nPRIORITY=0"
    assert b"MESSAGE\n" + struct.pack("<Q", len(text)) + text + b"\n" in _logged(inbox, text.decode())


def test_records_go_to_the_journal_only_if_stderr_does(inbox: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    assert journal_handler({"JOURNAL_STREAM": "1:2"}, inbox.getsockname()) is None
    assert journal_handler({}, inbox.getsockname()) is None
    monkeypatch.setattr(sys, "stderr", inbox)
    own = os.fstat(inbox.fileno())
    ours, other = f"{own.st_dev}:{own.st_ino}", f"{own.st_dev}:{own.st_ino + 1}"
    assert journal_handler({"JOURNAL_STREAM": other}, inbox.getsockname()) is None
    assert journal_handler({"JOURNAL_STREAM": ours}, inbox.getsockname() + "-gone") is None
    made = journal_handler({"JOURNAL_STREAM": ours}, inbox.getsockname())
    assert made is not None
    made.emit(logging.LogRecord("cm", 30, "", 1, "to the journal", (), None))
    made.close()
    assert b"MESSAGE=to the journal\n" in inbox.recv(1000)
    monkeypatch.setattr(sys, "stderr", io.StringIO())  # has no descriptor
    assert journal_handler({"JOURNAL_STREAM": ours}, inbox.getsockname()) is None

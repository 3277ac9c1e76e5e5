# SPDX-License-Identifier: Apache-2.0
"""What systemd and journald receive, read from the other end of their sockets."""

from __future__ import annotations

import logging
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

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
    service.reloading()
    service.stopping()
    assert inbox.recv(1000) == b"READY=1"
    first, second = inbox.recv(1000).split(b"\n")
    assert first == b"RELOADING=1"
    assert second.startswith(b"MONOTONIC_USEC=")
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
        ({}, None),
    ],
)
def test_signs_of_life_come_twice_as_often_as_they_are_waited_for(
    environment: dict[str, str], seconds: float | None
) -> None:
    assert ServiceManager({"NOTIFY_SOCKET": "/nowhere", **environment}).interval == seconds


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
    lines = _logged(inbox, "refused", cm_code="busy", cm_change=7).split(b"\n")
    assert {b"MESSAGE=refused", b"PRIORITY=4", b"CM_CODE=busy", b"CM_CHANGE=7"} <= set(lines)


def test_a_message_of_several_lines_travels_with_its_length(inbox: socket.socket) -> None:
    text = b"one\nPRIORITY=0"
    assert b"MESSAGE\n" + struct.pack("<Q", len(text)) + text + b"\n" in _logged(inbox, text.decode())


def test_records_go_to_the_journal_only_if_stderr_does(inbox: socket.socket) -> None:
    assert journal_handler({"JOURNAL_STREAM": "1:2"}, inbox.getsockname()) is None
    assert journal_handler({}, inbox.getsockname()) is None

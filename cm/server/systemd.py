# SPDX-License-Identifier: Apache-2.0
"""What a service has to do with systemd: signs of life, and records in the journal.

sd_notify(3) tells systemd, and others with its protocol, that the manager is ready; records go to journald with fields
of their own (systemd.journal-fields(7)).
"""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path


class ServiceManager:
    """The service manager that started us, if it wants messages; without `$NOTIFY_SOCKET` nothing is sent."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._watchdog = _watchdog(environment)

    @property
    def present(self) -> bool:
        """Whether there is one."""
        return bool(self._address)

    @property
    def interval(self) -> float | None:
        """Seconds between two signs of life: half of the time that it waits for one. None if it expects none."""
        return self._watchdog / 2 if self._watchdog and self._address else None

    def ready(self, status: str = "") -> None:
        """We answer from now on (again)."""
        self._send("READY=1", *([f"STATUS={status}"] if status else []))

    def reloading(self) -> None:
        """Schemas and settings are being read again; `ready` tells the end."""
        self._send("RELOADING=1", f"MONOTONIC_USEC={time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000}")

    def stopping(self) -> None:
        """We are about to end."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """A sign of life for the watchdog."""
        self._send("WATCHDOG=1")

    def _send(self, *lines: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        # A service manager that does not listen is no reason to stop; its own time-out will act.
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
            sock.setblocking(False)
            sock.sendto("\n".join(lines).encode(), address)


def _watchdog(environment: Mapping[str, str]) -> float:
    """Seconds that the service manager waits for a sign of life, 0 for none (sd_watchdog_enabled(3))."""
    meant = environment.get("WATCHDOG_PID", "")
    if meant and meant != str(os.getpid()):
        return 0.0
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) / 1e6 if text.isascii() and text.isdigit() else 0.0


_ADDRESS = "/run/systemd/journal/socket"
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6), (0, 7))
_FIELDS = ("cm_code", "cm_change")


def journal_handler(environment: Mapping[str, str] = os.environ, address: str = _ADDRESS) -> logging.Handler | None:
    """A handler if our stderr is the journal's stream, as under systemd; else None."""
    try:
        stderr = os.fstat(sys.stderr.fileno())
    except (OSError, ValueError):
        return None
    if environment.get("JOURNAL_STREAM") != f"{stderr.st_dev}:{stderr.st_ino}" or not Path(address).exists():
        return None
    return JournalHandler(address)


class JournalHandler(logging.Handler):
    """Sends each record as one datagram."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._address = address

    def emit(self, record: logging.LogRecord) -> None:
        """Send it; if the journal does not accept it, only this record is lost."""
        try:
            self._socket.sendto(b"".join(_encoded(*field) for field in self._fields(record)), self._address)
        except OSError:
            self.handleError(record)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
        super().close()

    def _fields(self, record: logging.LogRecord) -> Iterator[tuple[str, str]]:
        yield "MESSAGE", self.format(record)
        yield "PRIORITY", str(next(number for level, number in _PRIORITIES if record.levelno >= level))
        yield "SYSLOG_IDENTIFIER", "cm"
        yield "CODE_FUNC", record.funcName or ""
        for name in _FIELDS:
            value = getattr(record, name, None)
            if value not in (None, ""):
                yield name.upper(), str(value)


def _encoded(name: str, value: str) -> bytes:
    """``NAME=value``, or for a value of several lines its length in between."""
    data = value.encode("utf-8", "replace")
    if b"\n" not in data:
        return name.encode() + b"=" + data + b"\n"
    return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"

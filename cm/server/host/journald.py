# SPDX-License-Identifier: Apache-2.0
"""Log records as journald takes them, with fields of their own (systemd.journal-fields(7), its native protocol).

``journalctl CM_CODE=…`` and ``CM_CHANGE=…`` find what was logged with ``extra={"cm_code": …, "cm_change": …}``.
"""

from __future__ import annotations

import logging
import os
import socket
import struct
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

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

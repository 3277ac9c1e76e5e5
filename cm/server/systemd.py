# SPDX-License-Identifier: Apache-2.0
"""Signs of life for systemd, and others with its protocol: sd_notify(3) tells that the manager is ready."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress


class ServiceManager:
    """The service manager that started us, if it wants messages; without `$NOTIFY_SOCKET` nothing is sent."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._watchdog = _watchdog(environment)

    @property
    def interval(self) -> float | None:
        """Seconds between two signs of life: half of the time that it waits for one. None if it expects none."""
        return self._watchdog / 2 if self._watchdog and self._address else None

    def ready(self) -> None:
        """We answer from now on (again)."""
        self._send("READY=1")

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

# SPDX-License-Identifier: Apache-2.0
"""A handle to the process of a simulator: a child, or one that was taken over."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
from typing import Protocol


class Handle(Protocol):
    """A process that can be signalled and waited for."""

    @property
    def pid(self) -> int:
        """Its number."""

    @property
    def alive(self) -> bool:
        """Whether it runs."""

    def send(self, number: int) -> None:
        """Send a signal; harmless when it has ended."""

    def wait(self, timeout: float) -> int:
        """Its exit status (0 for one that was taken over); TimeoutExpired."""


class Child:
    """A process that we have started."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def send(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float) -> int:
        """Its exit status."""
        status = self._process.wait(timeout)
        if self._process.stdout is not None:
            self._process.stdout.close()
        return status


class Adopted:
    """A process whose parent has died."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._fd = os.pidfd_open(pid)

    @property
    def pid(self) -> int:
        """Its number."""
        return self._pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return not self._ended(0.0)

    def send(self, number: int) -> None:
        """Send a signal."""
        if self._fd >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._fd, number)

    def wait(self, timeout: float) -> int:
        """Wait for its end; only its parent learns the status."""
        if not self._ended(timeout):
            raise subprocess.TimeoutExpired("cm sim", timeout)
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
        return 0

    def _ended(self, timeout: float) -> bool:
        return self._fd < 0 or bool(select.select([self._fd], [], [], timeout)[0])

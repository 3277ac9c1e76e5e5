# SPDX-License-Identifier: Apache-2.0
"""Shared by tests of the bridges to ROS 2, whatever the transport."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cm import child
from cm.networks.ros.transport import Transport

PATIENCE = 60.0


class BridgeProcess:
    """`cm bridge NAME` beside a manager, once it has told its node's name."""

    def __init__(self, name: str, runtime: Path, arguments: tuple[str, ...], environment: dict[str, str]) -> None:
        words = child.command("cm.cli.main", "bridge", name, "--runtime-dir", str(runtime), *arguments)
        self.process = subprocess.Popen(words, stderr=subprocess.PIPE, env=environment)
        assert self.process.stderr is not None
        self.log = b""
        while b"cm bridge: /" not in self.log:
            ready, _, _ = select.select([self.process.stderr], [], [], PATIENCE)
            piece = os.read(self.process.stderr.fileno(), 65536) if ready else b""
            assert piece, f"the bridge did not start: {self.log.decode()}"
            self.log += piece

    def stop(self, number: int = signal.SIGINT) -> tuple[int, str]:
        """Stop it; return its exit status and its output."""
        self.process.send_signal(number)
        _, rest = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, (self.log + rest).decode()

    def end(self) -> None:
        """End it in any state; calling this twice is harmless."""
        assert self.process.stderr is not None
        self.process.kill()
        self.process.wait()
        self.process.stderr.close()


@contextmanager
def unanswered(transport: Transport, name: str, kind: str) -> Iterator[threading.Semaphore]:
    """A service that answers nobody before the end of the block, as get_result of a goal that goes on.

    Counts the requests that have reached it.
    """
    asked, let = threading.Semaphore(0), threading.Event()

    def answer(_: dict[str, Any]) -> dict[str, Any]:
        asked.release()
        let.wait()
        return {}

    transport.service(name, kind, answer)
    try:
        yield asked
    finally:
        let.set()

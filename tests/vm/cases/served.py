# SPDX-License-Identifier: Apache-2.0
"""The configuration manager on this board, as a process of its own, and what the simulated PL saw."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import cm

SYSTEM = Path("/opt/cm/guest/system/camera.yaml")
OVERLAYS = Path("/sys/kernel/config/device-tree/overlays")
PATIENCE = float(os.environ.get("CM_TEST_PATIENCE", "10"))  # seconds for one step
START = 5 * PATIENCE  # until a manager answers: all of Python has to come from the disk
_T = TypeVar("_T")


def until(condition: Callable[[], _T], timeout: float = PATIENCE) -> _T:
    """Poll for what nothing announces; returns the first true value."""
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError("the condition did not come true in time")


def pl(channel: str, name: str) -> Path:
    """A channel's file in the simulated PL's debugfs folder."""
    modelled = Path("/sys/kernel/debug/cm_axi", channel, name)  # of an engine under xilinx_dma
    return modelled if modelled.exists() else next(Path("/sys/kernel/debug/cm_plsim").glob(f"*/{channel}/{name}"))


def loads() -> int:
    """Bitstreams the port has taken."""
    return int(pl("icap", "loads").read_text(), 0)


def driver(device_name: str) -> str | None:
    """The driver bound to a platform device, None where there is no such device."""
    bound = Path("/sys/bus/platform/devices", device_name, "driver")
    return bound.readlink().name if bound.exists() else None


def system(folder: Path) -> Path:
    """The schema for this board: without overlays where the kernel has no interface for them."""
    text = SYSTEM.read_text()
    if not (OVERLAYS / "static").exists():
        text = "".join(line for line in text.splitlines(keepends=True) if "overlays:" not in line)
    target = folder / SYSTEM.name
    target.write_text(text)
    return target


class Manager:
    """A `cm serve` process; its state outlives it."""

    def __init__(self, folder: Path, config: Path | None = None) -> None:
        """`config`: a schema or a folder of them; this board's own if None."""
        self.runtime = folder / "run"
        self._log = folder / "log"
        self._command = [sys.executable, "-m", "cm.cli.main", "serve", "--config", str(config or system(folder))]
        self._command += ["--runtime-dir", str(self.runtime), "--state-dir", str(folder / "state")]
        self._command += ["--assume-loaded"]  # QEMU's boards have no PL of which a kernel could tell that it is loaded
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> Manager:
        self.process = subprocess.Popen(self._command, stderr=subprocess.PIPE, cwd="/")
        assert self.process.stderr is not None
        said = b""
        while b"ready at" not in said:
            ready, _, _ = select.select([self.process.stderr], [], [], START)
            piece = os.read(self.process.stderr.fileno(), 65536) if ready else b""
            assert piece, f"the manager did not start: {said.decode()}"
            said += piece
        return self

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    def kill(self) -> None:
        """As the kernel's out-of-memory killer would."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def _end(self, number: signal.Signals) -> None:
        if self.process is None:
            return
        self.process.send_signal(number)
        self.process.wait(PATIENCE)
        if self.process.stderr is not None:
            self.process.stderr.close()
        self.process = None

    @contextlib.contextmanager
    def connected(self) -> Iterator[cm.Board]:
        with cm.connect(runtime_dir=self.runtime, timeout=PATIENCE) as board:
            yield board

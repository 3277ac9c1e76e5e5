# SPDX-License-Identifier: Apache-2.0
"""Starts a simulated board with a manager on it, then the application, and clears everything away."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cm import child
from cm.errors import CmError, Timeout

_HOLD = 10  # frames for which the camera looks at one photograph
_START_TIMEOUT = 120.0  # the first time, its HDL is compiled
# What `cm build generate` makes of the example beside it.
_SCHEMA = Path(__file__).parents[2] / "data" / "examples" / "camera" / "config" / "camera.yaml"
SHEET = "contact-sheet.png"
FRAMES = "frames.npz"


class DemoFailed(CmError):
    """A part of the demonstration ended with an error."""

    code = "demo_failed"


def run_demo(images: Path | None, out: Path, keep_frames: bool = False, kind: str = "models") -> Path:
    """Run all of it; returns the path of the contact sheet. Raises DemoFailed.

    `kind`: what lies behind the simulated board's nodes, as `cm serve --sim` has it.
    """
    from cm.tools.demo.sheet import contact_sheet

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="cm-demo-") as folder, _Signals():
        runtime, frames = Path(folder, "run"), Path(folder, FRAMES)
        with _manager(runtime, images, kind):
            _application(runtime, frames)
        rows = _rows(frames)
        contact_sheet(rows, out / SHEET)
        if keep_frames:
            (out / FRAMES).write_bytes(frames.read_bytes())
    return out / SHEET


class _Signals:
    """SIGTERM ends the demo as Ctrl-C does, so that it is cleared away too."""

    def __enter__(self) -> None:
        self._before = signal.signal(signal.SIGTERM, _interrupt)

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGTERM, self._before)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


@contextlib.contextmanager
def _undisturbed() -> Iterator[None]:
    """A signal meanwhile counts at the end: within `Popen` it would leave a process that nobody knows."""
    came: list[int] = []
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.signal(number, lambda number, _: came.append(number)) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _manager(runtime: Path, images: Path | None, kind: str) -> Iterator[None]:
    """A manager with its board, in a process group of its own: Ctrl-C reaches it through us, in order."""
    command = child.command("cm.cli.main", "serve", f"--sim={kind}", "--runtime-dir", str(runtime))
    command += ["--config", str(_SCHEMA), "--load", "camera"]
    command += ["--sim-hold", str(_HOLD), *(["--images", str(images)] if images else [])]
    process = None
    try:
        with _undisturbed():
            process = subprocess.Popen(command, stderr=subprocess.PIPE, env=child.environment(), start_new_session=True)
        _await_ready(process)
        yield
    finally:
        if process is not None:
            _end(process)


def _await_ready(process: subprocess.Popen[bytes]) -> None:
    ready, said = child.said_until(process, b"ready at", _START_TIMEOUT)
    if not ready:
        raise DemoFailed(f"the configuration manager did not start: {said.decode(errors='replace').strip()}")


def _application(runtime: Path, frames: Path) -> None:
    command = child.command("cm.tools.demo.application", str(runtime), str(frames))
    process = None
    try:
        with _undisturbed():
            process = subprocess.Popen(command, env=child.environment())
        status = process.wait()
    finally:
        if process is not None:
            _end(process)
    if status != 0:
        raise DemoFailed(f"the application ended with status {status}")


def _end(process: subprocess.Popen[bytes]) -> None:
    in_time = child.ended(process)
    if process.stderr is not None:
        process.stderr.close()
    if not in_time:
        raise Timeout(f"{' '.join(process.args)} did not end and was killed")  # type: ignore[arg-type]


def _rows(frames: Path) -> dict[str, list[np.ndarray]]:
    """Label → pictures, from the application's file."""
    rows: dict[str, list[np.ndarray]] = {}
    with np.load(frames) as archive:
        for name in archive.files:
            label = name.partition(" ")[2].rpartition(" ")[0]
            rows.setdefault(label, []).append(archive[name])
    return rows

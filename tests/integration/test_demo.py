# SPDX-License-Identifier: Apache-2.0
"""The demonstration, run as a newcomer runs it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from manager_process import environment, until
from reference import sobel

from cm.simulation.software.hardware.camera import shipped_photos

PIL = pytest.importorskip("PIL.Image", reason="needs_pillow: the demo writes a picture with it")


def start(out: Path, scratch: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "cm", "demo", "--out", str(out), "--keep-frames"]
    env = {**environment(), "TMPDIR": scratch}
    # A shell's background job ignores SIGINT, and so would all below it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=env)


def processes_with(word: str) -> list[str]:
    """Command lines of living processes that name it."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
            if word in line:
                found.append(line)
    return found


@pytest.fixture
def scratch():  # type: ignore[no-untyped-def]
    """A folder for the demo's own files, with a name that shows in its processes' command lines."""
    with tempfile.TemporaryDirectory(prefix="cm-t-") as folder:
        yield folder


def test_the_demo_shows_each_mode_and_leaves_nothing(tmp_path: Path, scratch: str) -> None:
    demo = start(tmp_path, scratch)
    said, _ = demo.communicate(timeout=240)
    assert demo.returncode == 0, said
    assert "edge detection" in said
    with PIL.open(tmp_path / "contact-sheet.png") as sheet:
        assert sheet.width > 900
    with np.load(tmp_path / "frames.npz") as frames:
        edges = [frames[name] for name in frames.files if "edge detection" in name]
    expected = [sobel(photo) for photo in shipped_photos().values()]
    assert len(edges) == 3
    assert all(any(np.array_equal(edge, one) for one in expected) for edge in edges)
    until(lambda: processes_with(scratch) == [])
    assert os.listdir(scratch) == []  # noqa: PTH208


def test_ctrl_c_ends_the_demo_without_leftovers(tmp_path: Path, scratch: str) -> None:
    demo = start(tmp_path, scratch)
    until(lambda: len(processes_with(scratch)) >= 3, timeout=60)  # manager, simulator, application
    demo.send_signal(signal.SIGINT)
    demo.communicate(timeout=60)
    assert demo.returncode == 130
    until(lambda: processes_with(scratch) == [])
    assert os.listdir(scratch) == []  # noqa: PTH208

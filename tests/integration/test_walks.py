# SPDX-License-Identifier: Apache-2.0
"""docs/walks.md is true: a change of mode enters only the files that its walk names, few of them, none long."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest
from manager_process import CAMERA, short_folder

import cm
from cm.device import Root
from cm.schema import load_folder
from cm.server import sensor_watch
from cm.server import server as daemon
from cm.server.options import Options
from cm.simulation.software import Board as SimBoard

ROOT = Path(cm.__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "walks.md"
FOLDERS = ("cm/manager/", "cm/server/")
RIGHTS = "cm/server/rights/"  # a room of its own within the server's, asked by every route
FILES_MAX = 24


class Entered:
    """The files of manager and daemon whose functions were called, in whatever thread, while it was armed."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.armed = False

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        name = frame.f_code.co_filename
        if self.armed and event == "call" and name.startswith(str(ROOT)):
            path = str(Path(name).relative_to(ROOT))
            if path.startswith(FOLDERS) and not path.startswith(RIGHTS):
                self.files.add(path)


@contextmanager
def serving(folder: Path, root: Path) -> Iterator[Path]:
    """A daemon in a thread of this process, in the camera example's default mode; its runtime folder."""
    options = Options(folder / "run", folder / "state", Root.of(root), load_folder(CAMERA), load="camera/default")
    ready = threading.Event()
    server = daemon.Server(options)
    thread = threading.Thread(target=server.serve, args=(ready.set,))
    thread.start()
    try:
        assert ready.wait(60)
        with cm.connect(runtime_dir=options.runtime_dir, timeout=60) as board:
            board.load("camera", "default")
        yield options.runtime_dir
    finally:
        server.stop()
        thread.join()


@pytest.fixture(scope="module")
def entered() -> Iterator[set[str]]:
    """The files that one `cm mode` enters, without those that the daemon enters every second anyway."""
    found = Entered()
    patch = pytest.MonkeyPatch()
    patch.setattr(daemon, "_TICK", 3600.0)
    patch.setattr(sensor_watch, "_SECONDS", 3600.0)
    threading.setprofile(found)
    try:
        with (
            short_folder() as folder,
            SimBoard([CAMERA], root=folder / "board") as sim,
            serving(folder, sim.root) as runtime,
        ):
            found.armed = True
            command = [sys.executable, "-m", "cm", "mode", "edge_detection", "--runtime-dir", str(runtime)]
            subprocess.run(command, check=True, env=os.environ, timeout=120, cwd=ROOT, capture_output=True)
            found.armed = False
        yield found.files
    finally:
        threading.setprofile(None)
        patch.undo()


def walks() -> dict[str, set[str]]:
    """The files that each walk of the page names, by its heading."""
    parts = re.split(r"^## (.*)\n", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    pairs = zip(parts[::2], parts[1::2], strict=True)
    return {heading: set(re.findall(r"`(c[ms][a-z]*/[\w/.]+\.(?:py|c|proto))`", text)) for heading, text in pairs}


def test_the_walk_of_a_change_names_the_files_that_one_enters(entered: set[str]) -> None:
    walked = {path for path in walks()["A change of mode"] if path.startswith(FOLDERS)}
    assert entered - walked == set()
    assert walked - entered <= {"cm/server/durable_files.py"}  # an image may have been read before, when there was time


@pytest.mark.parametrize("heading", ["A register write", "A frame", "A change of mode"])
def test_a_walk_names_few_files_and_all_of_them_are_there(heading: str) -> None:
    paths = walks()[heading]
    assert 5 < len(paths) <= FILES_MAX, sorted(paths)
    assert {path for path in paths if not (ROOT / path).exists()} == set()

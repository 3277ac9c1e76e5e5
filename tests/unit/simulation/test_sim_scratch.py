# SPDX-License-Identifier: Apache-2.0
"""The next process removes the folders of a killed one, and no others."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
from pathlib import Path

import pytest

from cm import child
from cm.simulation.software.transport.scratch import LOCK, Scratch

_OWNER = "import sys, time; from cm.simulation.software.transport.scratch import Scratch; from pathlib import Path; \
print(Scratch('cm-x-', Path(sys.argv[1])).path, flush=True); time.sleep(600)"
_BOARD = "import time; from cm.simulation.software import Board; print(Board().root, flush=True); time.sleep(600)"


def started(code: str, *arguments: object) -> tuple[subprocess.Popen[bytes], Path]:
    """A process, and the folder that it says is its own."""
    process = subprocess.Popen(
        [child.command("cm")[0], "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, env=child.environment()
    )
    assert process.stdout is not None
    return process, Path(process.stdout.readline().decode().strip())


def killed(process: subprocess.Popen[bytes]) -> None:
    process.send_signal(signal.SIGKILL)
    process.communicate()


@pytest.fixture
def dead() -> int:
    """The id of a process that has ended."""
    process = subprocess.Popen(["true"])
    process.wait()
    return process.pid


def test_a_folder_stays_while_its_owner_lives_and_goes_when_it_was_killed(tmp_path: Path) -> None:
    process, folder = started(_OWNER, tmp_path)
    (folder / "file").write_text("x")
    with Scratch("cm-x-", tmp_path):
        assert (folder / "file").exists()
        killed(process)
        assert folder.exists()
    with Scratch("cm-x-", tmp_path) as own:
        assert list(tmp_path.iterdir()) == [own]
        assert own.stat().st_mode & 0o777 == 0o700
    assert list(tmp_path.iterdir()) == []


def test_the_folder_of_a_board_that_was_never_started_goes_with_the_next_board() -> None:
    process, folder = started(_BOARD)
    assert folder.is_dir()
    killed(process)
    with Scratch("cm-sim-"):
        assert not folder.exists()


def test_links_and_what_is_locked_or_served_or_has_another_name_stay(tmp_path: Path, dead: int) -> None:
    target = tmp_path / "target"
    target.mkdir()
    (target / "precious").touch()
    (tmp_path / f"cm-x-{dead}-link").symlink_to(target)
    names = ("locked", "served", "linked", "left")
    locked, served, linked, left = (tmp_path / f"cm-x-{dead}-{name}" for name in names)
    other = tmp_path / "cm-x-abcd"
    for folder in (locked, served, linked, left, other):
        folder.mkdir()
    (left / "inside").symlink_to(target)
    (linked / LOCK).symlink_to(target / "precious")
    holder = os.open(locked, os.O_RDONLY)
    fcntl.flock(holder, fcntl.LOCK_EX)
    with (served / LOCK).open("w") as simulator:
        fcntl.flock(simulator, fcntl.LOCK_EX)
        with Scratch("cm-x-", tmp_path):
            there = {path.name for path in tmp_path.iterdir()}
    os.close(holder)
    assert there >= {f"cm-x-{dead}-{name}" for name in ("link", "locked", "served", "linked")} | {other.name}
    assert left.name not in there
    assert (target / "precious").exists()


@pytest.mark.programs
@pytest.mark.skipif(os.getuid() != 0, reason="needs_root: to give a folder to another user")
def test_another_users_folder_stays(tmp_path: Path, dead: int) -> None:
    theirs = tmp_path / f"cm-x-{dead}-theirs"
    theirs.mkdir()
    os.chown(theirs, 12345, 12345)
    with Scratch("cm-x-", tmp_path):
        assert theirs.is_dir()

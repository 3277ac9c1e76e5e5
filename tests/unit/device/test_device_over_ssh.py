# SPDX-License-Identifier: Apache-2.0
"""`make device-suite BOARD=hw`: the suite runs on the other side of ssh, and its exit status comes back."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cm.device import find_uio
from cm.simulation.software import Board

REPOSITORY = Path(__file__).parents[3]
SCRIPT = REPOSITORY / "tests/device/over_ssh.py"
Run = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the script with a fake ssh, a shell in a separate folder of this machine that records its arguments."""
    ssh = tmp_path / "ssh"
    ssh.write_text(
        f'#!/bin/sh\necho "$@" | sed "s/ set -e.*//" > {tmp_path}/asked\n'
        f'for last; do :; done\ncd {tmp_path} && TMPDIR={tmp_path} exec sh -c "$last"\n'
    )
    ssh.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(SCRIPT), "--python", sys.executable, *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)

    return call


def test_the_suite_runs_there_and_nothing_is_left(run: Run, tmp_path: Path) -> None:
    with Board([REPOSITORY / "cm/data/camera/camera.yaml"]) as board:
        file = tmp_path / "asked.json"
        node = find_uio(0x1000, 4, board.root)[0].node
        file.write_text(json.dumps({"root": str(board.root), "uio": node, "scratch": 0x14}))
        done = run("--target", "root@board", "--board-file", str(file), "-k", "register_holds or two_files")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 passed" in done.stdout
    assert (tmp_path / "asked").read_text().strip() == "-o BatchMode=yes root@board"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["asked", "asked.json", "ssh"]


def test_a_test_that_fails_there_fails_here(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "wrong.json"
    file.write_text(f'{{"root": "{tmp_path}", "uio": "uio77"}}')
    done = run("--target", "board", "--board-file", str(file), "-k", "test_suite_uio")
    assert done.returncode == 1
    assert "uio77" in done.stdout


def test_the_board_of_a_labgrid_environment_is_asked(run: Run, tmp_path: Path) -> None:
    done = run("--lab", str(REPOSITORY / "tests/device/labgrid.yaml"), "--collect-only")
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "asked").read_text().strip() == "-o BatchMode=yes -p 22 ubuntu@kria.local"


def test_an_environment_without_an_address_is_reported(run: Run, tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("targets: {main: {resources: {}}}\n")
    done = run("--lab", str(tmp_path / "lab.yaml"))
    assert done.returncode == 1
    assert "target 'main' has no NetworkService with an address" in done.stderr

# SPDX-License-Identifier: Apache-2.0
"""The command ``cm sim``."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cm.cli.main import main
from cm.simulation.software import Board

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])}


@pytest.fixture(scope="module")
def root() -> Iterator[str]:
    with Board(arguments=["--hold", "0"]) as board:
        yield str(board.root)


def state(root: str, capsys: pytest.CaptureFixture[str]) -> dict:
    assert main(["sim", "state", "--root", root]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_command_serves_until_it_is_interrupted(tmp_path):
    command = [sys.executable, "-m", "cm.cli.main", "sim", "--root", str(tmp_path / "root")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=ENVIRONMENT) as process:
        ready = json.loads(process.stdout.readline())
        assert ready == {"ready": True, "root": str(tmp_path / "root"), "pid": process.pid}
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    assert not (tmp_path / "root").exists()


def test_a_fault_is_ordered_and_cleared(root, capsys):
    assert main(["sim", "inject", "short_packet", "camera", "1000", "--count", "2", "--root", root]) == 0
    assert state(root, capsys)["faults"] == ["short_packet camera value=1000 left=2"]
    assert main(["sim", "clear", "--root", root]) == 0
    assert state(root, capsys)["faults"] == []


def test_an_unknown_fault_fails_with_those_there_are(root, capsys):
    assert main(["sim", "inject", "meteor", "--root", root]) == 1
    assert "short_packet" in capsys.readouterr().err


def test_an_interrupt_that_does_not_exist_fails(root, capsys):
    assert main(["sim", "interrupt", "frame_done", "--root", root]) == 0
    assert main(["sim", "interrupt", "nothing", "--root", root]) == 1
    assert capsys.readouterr().err


def test_an_action_without_a_root_looks_where_a_manager_would_be(tmp_path, monkeypatch, capsys):
    monkeypatch.delenv("CM_ROOT", raising=False)
    monkeypatch.setenv("CM_RUNTIME_DIR", str(tmp_path))
    assert main(["sim", "state"]) == 1
    assert f"no simulated board in {tmp_path}/board" in capsys.readouterr().err


def test_an_action_without_a_simulator_fails_and_says_how_to_start_one(tmp_path, capsys):
    assert main(["sim", "state", "--root", str(tmp_path)]) == 1
    assert "cm sim --root" in capsys.readouterr().err

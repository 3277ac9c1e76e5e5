# SPDX-License-Identifier: Apache-2.0
"""The fixture `board` of the pytest plugin, in a project as a user has it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cm.child import environment

OWN = """
import sys

def test_nothing_is_imported_before_a_fixture_is_used():
    assert "cm.client" not in sys.modules

def test_a_register(board):
    board.registers["focus"] = 4
    assert board.registers["focus"] == 4

def test_each_test_begins_anew(board):
    assert board.registers["focus"] == 1

def test_an_application_that_connects_by_itself_finds_the_board_of_the_test(board):
    import cm
    board.registers["focus"] = 5
    own = cm.connect()
    assert own.registers["focus"] == 5
    own.lease("board", seconds=600).take()  # and forgets it

def test_a_fault(board, inject):
    inject("icap_crc")
    try:
        board.mode = "edge_detection"
    except Exception as error:
        assert "CRC" in str(error)
    else:
        assert False
    assert board.mode == "default"
"""


@pytest.mark.timeout(120)
def test_ten_lines_test_an_application(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text(OWN)
    (tmp_path / "pytest.ini").write_text("[pytest]\ncm_load = camera/default\n")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly"]
    if "cm" not in {point.name for point in _plugins()}:
        command += ["-p", "cm.tools.testing.plugin"]
    elsewhere = environment() | {"CM_CONNECT": "tcp://board.invalid", "CM_RUNTIME_DIR": "/nonexistent"}
    done = subprocess.run(command, cwd=tmp_path, env=elsewhere, capture_output=True, text=True, check=False)
    assert "5 passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.skipif(not hasattr(pytest, "SubtestReport"), reason="needs_pytest_9: files of its own types")
def test_settings_are_lists_and_text_as_pytest_9_types_them(tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text("def test_it(board):\n    assert board.configs == ('one',)\n")
    (tmp_path / "my schemas").mkdir()
    (tmp_path / "my schemas" / "one.yaml").write_text("config: {name: one, modes: {default: {}}}\n")
    settings = '[tool.pytest]\ncm_config = ["my schemas"]\ncm_load = "one/default"\n'
    (tmp_path / "pyproject.toml").write_text(settings)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly"]
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def _plugins() -> list[object]:
    from importlib.metadata import entry_points

    return list(entry_points(group="pytest11"))

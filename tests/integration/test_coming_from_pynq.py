# SPDX-License-Identifier: Apache-2.0
"""docs/coming-from-pynq.md: this package's side of every task runs, in the page's order, as one program."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import REPOSITORY, environment, served

PAGE = (REPOSITORY / "docs/coming-from-pynq.md").read_text()
BLOCKS = re.findall(r"^```python\n(# [^\n]*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
OURS = [code for head, code in BLOCKS if head == "# fpga-cm"]
THEIRS = [code for head, code in BLOCKS if head == "# PYNQ"]


def test_every_block_is_of_one_side() -> None:
    assert len(OURS) + len(THEIRS) == len(BLOCKS) == PAGE.count("```python")
    assert len(OURS) == 9


@pytest.mark.parametrize("code", THEIRS, ids=range(len(THEIRS)))
def test_the_other_side_is_python(code: str) -> None:
    ast.parse(code)


def test_our_side_runs_from_top_to_bottom(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text("\n".join([*OURS, "board.close()\n"]))
    with served() as (manager, sim):
        env = {**environment(), "CM_RUNTIME_DIR": str(manager.runtime), "CM_ROOT": str(sim.root)}
        done = subprocess.run(
            [sys.executable, "-W", "error", program], env=env, capture_output=True, text=True, timeout=240, check=False
        )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("default ['version'")
    assert "7" in lines
    assert "True" in lines
    assert lines[-1] == "(480, 640)"

# SPDX-License-Identifier: Apache-2.0
"""The pages of docs/boards: their design is generated for each board, and their script gets frames from it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import Manager, environment, short_folder, until

pytestmark = pytest.mark.design

pytest.importorskip("jinja2", reason="needs the extra build")
pytest.importorskip("pyslang", reason="needs the extra build")

REPOSITORY = Path(__file__).parents[2]
LOOP = REPOSITORY / "docs/boards/loop"
PAGES = sorted(page.stem for page in (REPOSITORY / "docs/boards").glob("*.md") if page.stem != "README")


def generated(board: str, folder: Path) -> Path:
    """The folder with what `cm build generate` writes for a board."""
    text = (LOOP / "build.yaml").read_text("utf-8").replace("../../..", str(REPOSITORY))
    (folder / "build.yaml").write_text(re.sub(r"board: .*", f"board: {board}", text), "utf-8")
    command = [sys.executable, "-m", "cm", "build", "generate", str(folder / "build.yaml")]
    subprocess.run(command, check=True, capture_output=True, env=environment())
    return folder / "build"


@pytest.mark.parametrize("page", PAGES)
def test_the_design_is_generated_for_the_board_of_each_page(page: str, tmp_path: Path) -> None:
    out = generated(page, tmp_path)
    assert (out / "dts/loop_static.dtso").exists()
    assert "loader: auto" in (out / "config/loop.yaml").read_text("utf-8")


@pytest.mark.parametrize("page", ["README", *PAGES])
def test_each_step_says_whether_it_was_proved_read_or_is_open(page: str) -> None:
    text = (REPOSITORY / f"docs/boards/{page}.md").read_text("utf-8").partition("## Sources")[0]
    tables = re.findall(r"^\|.*\| \|\n\|-.*\n((?:\|.*\n)+)", text, re.MULTILINE)
    steps = "".join(tables).splitlines()
    assert steps
    assert [row for row in steps if not re.search(r"\| [^|]*\b(?:Q|S\d|O)\b[^|]*\|$", row)] == []
    said = re.findall(r"^ *- .*[^:]$", text, re.MULTILINE)
    assert [line for line in said if not re.search(r"\([^()]*\b(?:Q|S\d|O)\b[^()]*\)", line)] == []


def test_the_script_gets_its_frames_on_a_simulated_board(tmp_path: Path) -> None:
    config = generated("pynq-z2", tmp_path) / "config"
    with short_folder() as folder:
        manager = Manager(folder / "run", "--sim", "--config", str(config), "--load", "loop").start()
        try:
            with manager.connected() as board:
                until(lambda: board.mode == "default")
            env = {**environment(), "CM_RUNTIME_DIR": str(manager.runtime)}
            command = [sys.executable, str(LOOP / "first_frame.py")]
            done = subprocess.run(command, capture_output=True, text=True, env=env, timeout=120, check=False)
        finally:
            manager.stop()
    assert done.stdout.splitlines() == [
        "default: 10 of 10 frames came, 10 of them as they were sent",
        "edges: 10 of 10 frames came, 0 of them as they were sent",
    ], done.stderr

# SPDX-License-Identifier: Apache-2.0
"""The notebooks of the docs run from top to bottom against `cm serve --sim`, and show what they say."""

from __future__ import annotations

import base64
import io
import json
import re
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from manager_process import REPOSITORY, Manager, environment, short_folder
from PIL import Image

import cm
from cm.cli.main import main

pytestmark = pytest.mark.programs
_RICHNESS = ("image/png", "text/html", "text/plain", "text")
NOTEBOOKS = sorted((REPOSITORY / "docs/notebooks").glob("*.ipynb"))


@contextmanager
def serving() -> Iterator[Manager]:
    """`cm serve --sim`, as the notebooks require."""
    with short_folder() as folder:
        assert main(["keygen", str(folder / "keys"), "laptop"]) == 0
        keys = ("--listen", "tcp://127.0.0.1:0", "--keys", str(folder / "keys/server.key"))
        manager = Manager(folder / "run", "--sim", *keys)
        manager.start()
        try:
            yield manager
        finally:
            manager.stop()


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Each notebook after it has run; an error in a cell is an error here."""
    folder = tmp_path_factory.mktemp("notebooks")
    with serving() as manager, pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of jupyter's packages about each other
        import nbclient
        import nbformat

        patch.setenv("CM_RUNTIME_DIR", str(manager.runtime))
        patch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
        patch.setenv("IPYTHONDIR", str(folder))
        patch.setenv("JUPYTER_RUNTIME_DIR", str(folder))

        def execute(path: Path) -> Any:
            notebook = nbformat.read(path, as_version=4)
            resources = {"metadata": {"path": str(folder)}}
            nbclient.NotebookClient(notebook, timeout=120, startup_timeout=120, resources=resources).execute()
            return notebook

        done = {path.stem: execute(path) for path in NOTEBOOKS}
        patch.delenv("CM_RUNTIME_DIR")
        patch.setenv("CM_CONNECT", manager.tcp())
        patch.setenv("CM_KEYS", str(manager.runtime.parent / "keys/laptop.key"))
        return {**done, "elsewhere": execute(NOTEBOOKS[0])}


COMPLETE = """
import json, sys
from IPython.core.completer import provisionalcompleter
from IPython.core.interactiveshell import InteractiveShell

shell = InteractiveShell.instance()
assert shell.run_cell("import cm; board = cm.connect(); board.load('camera', 'edge_detection')").success
with provisionalcompleter():
    print(json.dumps({line: [c.text for c in shell.Completer.completions(line, len(line))] for line in sys.argv[1:]}))
"""
TYPED = {
    'board.registers["thr': "threshold",
    'board.registers["led.bl': "led.blink",
    "board.registers.foc": "focus",
    'board.interrupts["fra': "frame_done",
    'board.memories["scr': "scratchpad",
    "cm.conn": "connect",
    'board.mode = "edge': "edge_detection",
    "board.set_mode('edge": "edge_detection",
    'board.load("cam': "camera",
    'board.load("camera", mode="edge': "edge_detection",
    'x = board.stream("from': "from_pl",
    'board.unload("prr1': "prr1",
}


def test_tab_in_ipython_completes_names_of_what_runs_as_it_is_set_up_by_default(
    board: cm.Board, manager: Manager, tmp_path: Path
) -> None:
    """By default it evaluates no property of unknown objects."""
    assert board.mode == "default"
    done = subprocess.run(
        [sys.executable, "-c", COMPLETE, *TYPED],
        env={**environment(), "CM_RUNTIME_DIR": str(manager.runtime), "IPYTHONDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == {line: [name] for line, name in TYPED.items()}


def outputs(notebook: Any, kind: str) -> list[str]:
    """The outputs of its cells in a MIME type."""
    shown = [output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ())]
    return [data[kind] for data in shown if kind in data]


def printed(notebook: Any) -> str:
    return "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", ()))


def pictures(notebook: Any) -> list[Image.Image]:
    return [Image.open(io.BytesIO(base64.b64decode(data))) for data in outputs(notebook, "image/png")]


def kinds(notebook: Any) -> list[list[str]]:
    """What each cell shows: text, or the richest MIME type of a value."""
    of_cells = [cell.get("outputs", ()) for cell in notebook["cells"]]
    return [[min(output.get("data", {"text": ""}), key=_RICHNESS.index) for output in cell] for cell in of_cells]


@pytest.mark.timeout(600)
def test_there_are_three_of_them_with_what_they_show_and_nothing_of_a_machine(executed: dict[str, Any]) -> None:
    assert [path.stem for path in NOTEBOOKS] == ["first-look", "focus", "modes"]
    for path in NOTEBOOKS:
        text = path.read_text()
        assert kinds(json.loads(text)) == kinds(executed[path.stem]), "run: .venv/bin/python docs/notebook_outputs.py"
        assert len(text) < 150_000
        assert not re.search(r"/(?:home|root|tmp|work|build)/|traceback", text)


@pytest.mark.timeout(600)
def test_the_first_look_shows_board_plan_registers_and_a_frame(executed: dict[str, Any]) -> None:
    notebook = executed["first-look"]
    shown = outputs(notebook, "text/html")
    assert "camera/default" in shown[0]
    assert any("load edge into prr0" in text for text in shown)
    assert any("camera/edge_detection" in text and "<th" in text for text in shown)
    assert any("1 slow" in text and "threshold" in text for text in shown)
    assert "did you mean 'threshold'?" in printed(notebook)
    assert [picture.size for picture in pictures(notebook)] == [(640, 480)]


@pytest.mark.timeout(600)
def test_the_same_notebook_runs_over_tcp_with_keys(executed: dict[str, Any]) -> None:
    assert "&lt;board at tcp://127.0.0.1:" in outputs(executed["elsewhere"], "text/html")[0]
    assert [picture.size for picture in pictures(executed["elsewhere"])] == [(640, 480)]


@pytest.mark.timeout(600)
def test_the_camera_focuses(executed: dict[str, Any]) -> None:
    assert printed(executed["focus"]).count("<- sharpest") == 1
    assert [picture.size for picture in pictures(executed["focus"])] == [(1280, 480)]


@pytest.mark.timeout(600)
def test_modes_are_shown_side_by_side(executed: dict[str, Any]) -> None:
    assert [(p.size, p.mode) for p in pictures(executed["modes"])] == [((1920, 480), "L"), ((640, 480), "RGB")]
    assert "frame_done" in printed(executed["modes"])


SLOWLY = """
import cm, cm.client.progress
cm.client.progress._AT_ONCE = 0.0  # however quick this machine is
board = cm.connect()
board.mode = "edge_detection"
print(board.mode)
"""


@pytest.mark.timeout(600)
def test_a_load_that_lasts_draws_a_bar_that_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When it ends, the bar disappears."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import nbclient
        import nbformat

        monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
        monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
        monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path))
        seen = []

        class Watching(nbclient.NotebookClient):
            def process_message(self, msg: Any, cell: Any, cell_index: int) -> Any:
                data = msg["content"].get("data", {})
                seen.append((msg["msg_type"], data.get("text/html", "")))
                return super().process_message(msg, cell, cell_index)

        with serving() as manager:
            monkeypatch.setenv("CM_RUNTIME_DIR", str(manager.runtime))
            notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(SLOWLY)])
            Watching(notebook, timeout=120, startup_timeout=120).execute()
    assert printed(notebook) == "edge_detection\n"
    bars = [(kind, text) for kind, text in seen if "<progress" in text]
    assert bars[0][0] == "display_data"
    assert {kind for kind, _ in bars[1:]} <= {"update_display_data"}
    assert outputs(notebook, "text/html") == [""]

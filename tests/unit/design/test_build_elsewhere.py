# SPDX-License-Identifier: Apache-2.0
"""The flow on another host: the folder copied, run under another root with the stand-in for Vivado, and copied back."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs
from test_build_tcl import TCL, known_commands

from cm.design.run.flow import Flow, State
from cm.design.run.make import run_flow
from cm.design.run.vivado import Vivado

VIVADO = Path(__file__).parents[1] / "vivado_replay.sh"
pytestmark = [needs("make"), needs("tclsh")]


def states(out: Path) -> set[State]:
    return {entry.state for entry in Flow(out).plan()}


def test_a_copied_flow_runs_under_another_root_and_comes_back_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "known").write_text(known_commands())
    for name, value in (("REPLAY", TCL), ("KNOWN", tmp_path / "known"), ("SEEN", tmp_path / "seen")):
        monkeypatch.setenv(f"CM_{name}", str(value))
    here, elsewhere = tmp_path / "here", tmp_path / "far away/host"
    here.mkdir()
    generated(copy_examples(here), "two_regions")  # which reads another example's HDL
    shutil.copytree(here, elsewhere)
    shutil.move(here, tmp_path / "unreachable")  # nothing there may read files from here
    out, far = here / "two_regions/build", elsewhere / "two_regions/build"
    command = ["make", f"VIVADO={shlex.quote(str(VIVADO))}"]
    done = subprocess.run(command, cwd=far, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    shutil.move(tmp_path / "unreachable", here)
    assert all(line.startswith(f"{far} ") for line in (tmp_path / "seen").read_text().splitlines())
    shutil.copytree(far, out, dirs_exist_ok=True)
    assert states(out) == {State.DONE}
    assert run_flow(out, Vivado(VIVADO, (2023, 2)), 1, lambda _: None)
    source = here / "camera/hdl/camera_edge.v"
    source.write_text(source.read_text() + "// changed\n")
    assert states(out) > {State.DONE, State.CHANGED}

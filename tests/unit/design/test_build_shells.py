# SPDX-License-Identifier: Apache-2.0
"""Abstract shells: modules beyond the first run without the static design, replayed and run step by step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from build_support import needs, project
from test_build_tcl import after_all, before, replay, scripts

from cm.cli.main import main
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design, output_folder
from cm.design.run.flow import Flow, State
from cm.design.run.make import run_flow
from cm.design.run.vivado import Vivado

FAKE = Path(__file__).parents[1] / "fake_vivado.sh"
SHELLS = """\
project: {name: small, part: xck26-sfvc784-2LV-c}
static: {abstract_shells: true}
regions:
  left: {pblock: auto}
  right: {pblock: auto}
modules:
  one: {sources: [one.v], regions: [left]}
  two: {sources: [one.v], top: one, regions: [left]}
  three: {sources: [one.v], top: one, regions: [right]}
  four: {sources: [one.v], top: one, regions: [right]}
"""


def made(folder: Path, text: str = SHELLS) -> tuple[Design, Path]:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    folder.mkdir(exist_ok=True)
    design = load_design(project(folder, text))
    out = output_folder(design.project, None)
    generate(design, out)
    return design, out


def steps(out: Path) -> list[str]:
    return [step["name"] for step in json.loads((out / "steps.json").read_text())["steps"]]


def test_there_is_one_run_of_the_whole_design_and_a_shell_for_every_region(tmp_path: Path) -> None:
    _, out = made(tmp_path)
    found = steps(out)
    assert [name for name in found if name.startswith("run_")] == ["run_1"]
    assert found[-4:] == ["shell_left", "shell_right", "module_two", "module_four"]


@needs("tclsh")
def test_every_step_replays_and_no_modules_step_opens_the_static_design(tmp_path: Path) -> None:
    _, out = made(tmp_path / "p")
    for script in scripts(out):
        status, said, calls = replay(out, script, tmp_path)
        assert status == 0, f"{script}: {said}"
        if "step_module" in script:
            opened = [call for call in calls if call.startswith("open_checkpoint")]
            region = "left" if "two" in script else "right"
            assert opened == [f"open_checkpoint checkpoints/shell_{region}.dcp"]
        if "step_shell_right" in script:
            for path in (tmp_path / "work/p/build/checkpoints").glob("*"):
                if path.name.startswith(("static", "run_1")):
                    path.unlink()
    work = tmp_path / "work/p/build"
    ids = {path.name: path.read_text() for path in (work / "checkpoints").glob("*.id")}
    assert sorted(ids) == ["shell_left.id", "shell_right.id"]
    assert len(set(ids.values())) == 1, "all bitstreams have one USERID"


@needs("tclsh")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("checkpoints/shell_left.dcp -additional", "checkpoints/run_1.dcp -additional", "are not of one kind"),
        ("checkpoints/shell_left.dcp -additional", "checkpoints/shell_right.dcp -additional", "are not of one kind"),
        ("-cell static_part/left bitstreams", "bitstreams", "-cell is needed"),
        (
            "read_checkpoint -cell static_part/left",
            "read_checkpoint -cell static_part/right",
            "not in the abstract shell",
        ),
        ("checkpoints/synth_two.dcp", "checkpoints/run_1.dcp", "is not a module synthesised out of context"),
        ("read_checkpoint", "#", "holds no module"),
    ],
)
def test_what_vivado_refuses_of_an_abstract_shell_is_refused(old: str, new: str, said: str, tmp_path: Path) -> None:
    """UG909: pr_verify compares designs of one kind; a shell gives partial bitstreams of its region alone."""
    _, out = made(tmp_path / "p")
    before(out, "tcl/step_module_two.tcl", tmp_path)
    script = tmp_path / "work/p/build/tcl/step_module_two.tcl"
    text = script.read_text()
    assert old in text
    script.write_text(text.replace(old, new))
    status, told, _ = replay(out, "tcl/step_module_two.tcl", tmp_path)
    assert status == 1
    assert said in told


@needs("tclsh")
@pytest.mark.parametrize(
    ("script", "environment", "said"),
    [
        ("tcl/step_shell_left.tcl", {"CM_VERSION": "2020.1"}, "abstract shells need Vivado 2020.2 or newer"),
        ("tcl/step_module_two.tcl", {"CM_PR_VERIFY": "0"}, "two does not leave its shell as it was"),
        ("tcl/step_module_two.tcl", {"CM_SLACK": "-0.1"}, "module_two misses timing"),
    ],
)
def test_a_step_in_a_shell_ends_the_flow_as_any_other(
    script: str, environment: dict[str, str], said: str, tmp_path: Path
) -> None:
    _, out = made(tmp_path / "p")
    status, told, calls = after_all(out, script, tmp_path, **environment)
    assert status == 1
    assert said in told
    assert not [call for call in calls if call.startswith("write_bitstream")]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("xck26-sfvc784-2LV-c", "xc7z020clg400-1", "7 series are not supported (UG909)"),
        ("name: small,", "name: small, vivado: '2020.1',", "Vivado 2020.1 has no abstract shells (2020.2 or newer"),
    ],
)
def test_shells_where_vivado_has_none_are_refused_with_their_place(
    old: str, new: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(BuildError) as caught:
        made(tmp_path, SHELLS.replace(old, new))
    assert said in str(caught.value)
    assert "static.abstract_shells" in str(caught.value)


@needs("make")
def test_a_new_module_runs_its_synthesis_and_its_shell_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_CALLS", str(tmp_path / "calls"))
    _, out = made(tmp_path / "p")
    vivado = Vivado(FAKE, (2023, 2))
    run_flow(out, vivado, 1, lambda _: None)
    (tmp_path / "calls").unlink()
    made(tmp_path / "p", SHELLS + "  five: {sources: [one.v], top: one, regions: [left]}\n")
    run_flow(out, vivado, 1, lambda _: None)
    assert (tmp_path / "calls").read_text().split() == ["synth_five", "module_five"]


@needs("make")
def test_one_module_is_run_by_name_with_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_CALLS", str(tmp_path / "calls"))
    _, out = made(tmp_path / "p")
    run_flow(out, Vivado(FAKE, (2023, 2)), 1, lambda _: None, ["two"])
    ran = set((tmp_path / "calls").read_text().split())
    assert "module_two" in ran
    assert not ran & {"synth_four", "module_four", "shell_right", "bitstreams_run_1"}
    assert {p.step.name for p in Flow(out).plan() if p.state is State.DONE} == ran


def test_a_missing_module_is_reported_with_those_that_exist(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    made(tmp_path)
    assert main(["build", "run", "--dry-run", "--module", "tow", str(tmp_path / "build.yaml")]) == 1
    assert "no step makes a bitstream of 'tow'; there are four, one, three, two" in capsys.readouterr().err


def test_check_says_which_modules_are_built_in_shells(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    main(["build", "check", str(project(tmp_path, SHELLS))])
    said = capsys.readouterr().out
    assert "two: in the abstract shell of left" in said
    assert "1 implementation run (the fewest possible)" in said

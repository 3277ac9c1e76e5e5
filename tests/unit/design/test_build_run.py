# SPDX-License-Identifier: Apache-2.0
"""The flow runs step by step, resumes where it stopped, and skips what did not change."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs

from cm.cli.main import main
from cm.design.errors import BuildError, MissingTool, StepFailed
from cm.design.generate.tree import generate, load_design
from cm.design.run.make import run_flow
from cm.design.run.steps import Flow, State
from cm.design.run.vivado import Vivado, find_vivado

FAKE = Path(__file__).parents[1] / "fake_vivado.sh"
VIVADO = Vivado(FAKE, (2023, 2))
RUNS = {"run_1", "run_2", "run_3"}

pytestmark = needs("make")


@pytest.fixture
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("CM_CALLS", str(tmp_path / "calls"))
    return generated(copy_examples(tmp_path), "camera")[1]


def calls(out: Path) -> list[str]:
    path = out.parent.parent / "calls"
    return path.read_text().split() if path.exists() else []


def run(out: Path, jobs: int = 1) -> list[str]:
    """Run the flow and return its output."""
    before = len(calls(out))
    said: list[str] = []
    run_flow(out, VIVADO, jobs, said.append)
    assert len(calls(out)) >= before
    return said


def states(out: Path) -> dict[str, State]:
    return {entry.step.name: entry.state for entry in Flow(out).plan()}


def test_every_step_runs_once_and_after_those_it_needs(out: Path) -> None:
    run(out, jobs=2)
    order = calls(out)
    assert sorted(order) == sorted(step.name for step in Flow(out).steps)
    for step in Flow(out).steps:
        assert all(order.index(name) < order.index(step.name) for name in step.after)
    assert set(states(out).values()) == {State.DONE}


def test_a_second_run_does_nothing(out: Path) -> None:
    run(out)
    count = len(calls(out))
    assert run(out) == ["nothing to do: all steps are done and their inputs unchanged"]
    assert len(calls(out)) == count


def test_touching_a_file_without_changing_it_runs_nothing(out: Path) -> None:
    run(out)
    source = out.parent / "hdl/camera_edge.v"
    source.write_text(source.read_text())
    assert set(states(out).values()) == {State.DONE}


def test_a_changed_module_is_synthesised_and_implemented_again(out: Path) -> None:
    run(out)
    count = len(calls(out))
    source = out.parent / "hdl/camera_edge.v"
    source.write_text(source.read_text() + "// changed\n")
    changed = {name for name, state in states(out).items() if state is not State.DONE}
    run(out)
    again = set(calls(out)[count:])
    assert again == changed
    assert "synth_edge" in again
    assert not {"synth_default", "synth_colorise", "static", "system", "run_1"} & again


def test_generating_again_without_a_change_runs_nothing(out: Path) -> None:
    run(out)
    generate(load_design(out.parent / "build.yaml"), out)
    assert set(states(out).values()) == {State.DONE}


def test_a_failed_step_is_reported_with_its_log_and_the_next_run_goes_on(
    out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CM_FAIL", "run_2")
    with pytest.raises(StepFailed, match=r"step run_2 failed.*\n.*2: ERROR: \[Place 30-99\]"):
        run(out)
    assert states(out)["run_1"] is State.DONE
    monkeypatch.delenv("CM_FAIL")
    count = len(calls(out))
    run(out)
    assert calls(out)[count] == "run_2"
    assert "system" not in calls(out)[count:]


def test_progress_names_each_step_and_counts(out: Path) -> None:
    said = run(out)
    assert "system: block design" in said
    assert any(line.startswith("system: done in") and line.endswith("(1 of 12)") for line in said)


def test_an_output_that_is_gone_is_made_again(out: Path) -> None:
    run(out)
    (out / "checkpoints/synth_edge.dcp").unlink()
    assert states(out)["synth_edge"] is State.LOST
    count = len(calls(out))
    run(out)
    assert "synth_edge" in calls(out)[count:]


def test_the_dry_run_lists_the_steps_and_runs_none(out: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "run", "--dry-run", "--json", str(out.parent / "build.yaml")]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert [entry["step"] for entry in steps] == [step.name for step in Flow(out).steps]
    assert {entry["state"] for entry in steps} == {"new"}
    assert calls(out) == []


def test_the_command_runs_the_flow(out: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "run", str(out.parent / "build.yaml"), "--vivado", str(FAKE)]) == 0
    assert "Vivado 2023.2" in capsys.readouterr().out
    assert len(calls(out)) == 12


def test_a_vivado_in_a_folder_of_any_name_runs_the_flow(out: Path, tmp_path: Path) -> None:
    folder = tmp_path / "it's my $tools"
    folder.mkdir()
    (folder / "vivado").symlink_to(FAKE)
    assert main(["build", "run", str(out.parent / "build.yaml"), "--vivado", str(folder / "vivado")]) == 0
    assert len(calls(out)) == 12


def test_without_a_generated_flow_there_is_nothing_to_run(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="run cm build generate first"):
        Flow(tmp_path)


def test_vivado_is_found_by_path_by_variable_and_by_setting(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/vivado").symlink_to(FAKE)
    path = f"{tmp_path / 'bin'}:/usr/bin:/bin"
    for setting, environment in (
        (None, {"PATH": path}),
        (None, {"XILINX_VIVADO": str(tmp_path), "PATH": ""}),
        (str(tmp_path), {"PATH": ""}),
    ):
        assert find_vivado(setting, environment).version == (2023, 2)


def test_no_vivado_is_reported_with_what_to_do() -> None:
    with pytest.raises(MissingTool, match="settings64"):
        find_vivado(None, {"PATH": "/nowhere"})


def test_a_version_that_the_schema_does_not_want_is_refused() -> None:
    with pytest.raises(BuildError, match=r"insists on Vivado 2022\.1"):
        find_vivado(str(FAKE), {}, "2022.1")


def test_an_old_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_VERSION", "2019.2")
    with pytest.raises(BuildError, match=r"2020\.1 or newer"):
        find_vivado(str(FAKE), {})

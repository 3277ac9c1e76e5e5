# SPDX-License-Identifier: Apache-2.0
"""The flow runs step by step, skips what did not change, fails or is interrupted anywhere, and resumes there."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs

from cm.cli.main import main
from cm.design.errors import BuildError, MissingTool, StepFailed
from cm.design.generate.generation import generate, load_design
from cm.design.run.flow import Flow, State
from cm.design.run.make import run_flow
from cm.design.run.vivado import Vivado, find_vivado

FAKE = Path(__file__).parents[1] / "fake_vivado.sh"
VIVADO = Vivado(FAKE, (2023, 2))
RUNS = ("run_1", "run_2", "run_3")
SYNTHESIS = ("static", "synth_default", "synth_edge", "synth_colorise")
STEPS = ("system", *SYNTHESIS, *RUNS, "verify", *(f"bitstreams_{run}" for run in RUNS))

pytestmark = needs("make")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The camera example, generated once."""
    folder = copy_examples(tmp_path_factory.mktemp("examples"))
    generated(folder, "camera")
    return folder


@pytest.fixture
def out(tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(tree, tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("CM_CALLS", str(tmp_path / "calls"))
    return tmp_path / "camera/build"


def calls(out: Path) -> list[str]:
    path = out.parent.parent / "calls"
    return path.read_text().split() if path.exists() else []


def run(out: Path, jobs: int = 1) -> list[str]:
    """Run the flow and return its output."""
    said: list[str] = []
    run_flow(out, VIVADO, jobs, said.append)
    return said


def states(out: Path) -> dict[str, State]:
    return {entry.step.name: entry.state for entry in Flow(out).plan()}


def test_every_step_runs_once_and_after_those_it_needs_and_progress_names_and_counts_them(out: Path) -> None:
    said = run(out, jobs=2)
    order = calls(out)
    assert tuple(step.name for step in Flow(out).steps) == STEPS
    assert sorted(order) == sorted(STEPS)
    for step in Flow(out).steps:
        assert all(order.index(name) < order.index(step.name) for name in step.after)
    assert set(states(out).values()) == {State.DONE}
    assert "system: block design" in said
    done = [line for line in said if ": done in" in line]
    assert any(line.startswith("system: ") for line in done)
    assert [line.rpartition(" (")[2] for line in done] == [f"{number} of 12)" for number in range(1, 13)]


def test_what_did_not_change_is_not_run_again(out: Path) -> None:
    """Nor after a file was written as it was, or generated again."""
    run(out)
    source = out.parent / "hdl/camera_edge.v"
    source.write_text(source.read_text())
    generate(load_design(out.parent / "build.yaml"), out)
    assert set(states(out).values()) == {State.DONE}
    assert run(out) == ["nothing to do: all steps are done and their inputs unchanged"]
    assert len(calls(out)) == len(STEPS)


def test_a_changed_module_and_an_output_that_is_gone_are_made_again(out: Path) -> None:
    run(out)
    source = out.parent / "hdl/camera_edge.v"
    source.write_text(source.read_text() + "// changed\n")
    (out / "checkpoints/synth_colorise.dcp").unlink()
    found = states(out)
    assert (found["synth_edge"], found["synth_colorise"]) == (State.CHANGED, State.LOST)
    run(out)
    again = set(calls(out)[len(STEPS) :])
    assert again == {name for name, state in found.items() if state is not State.DONE}
    assert not {"synth_default", "static", "system", "run_1"} & again


def test_the_dry_run_lists_the_steps_and_runs_none(out: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "run", "--dry-run", "--json", str(out.parent / "build.yaml")]) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    assert [entry["step"] for entry in steps] == [step.name for step in Flow(out).steps]
    assert {entry["state"] for entry in steps} == {"new"}
    assert calls(out) == []


def test_the_command_runs_the_flow_with_a_vivado_in_a_folder_of_any_name(
    out: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    folder = tmp_path / "it's my $tools"
    folder.mkdir()
    (folder / "vivado").symlink_to(FAKE)
    assert main(["build", "run", str(out.parent / "build.yaml"), "--vivado", str(folder / "vivado")]) == 0
    assert "Vivado 2023.2" in capsys.readouterr().out
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


def behind(out: Path, failed: str) -> set[str]:
    """`failed` and the steps that depend on it, directly or not."""
    found = {failed}
    for step in Flow(out).steps:
        found |= {step.name} if found.intersection(step.after) else set()
    return found


@pytest.mark.parametrize("failed", STEPS)
def test_a_failure_at_any_step_is_reported_and_the_flow_goes_on_there(
    out: Path, failed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CM_FAIL", failed)
    with pytest.raises(StepFailed) as failure:
        run_flow(out, VIVADO, 1, lambda _: None)
    assert str(failure.value) == (
        f"step {failed} failed; {out}/logs/{failed}.log says:\n"
        "    2: ERROR: [Place 30-99] Placer failed with error: 'too small'"
    )
    assert all(states(out)[name] is State.NEW for name in behind(out, failed))
    assert not behind(out, failed).intersection(calls(out)) - {failed}
    left = {entry.step.name for entry in Flow(out).unfinished()}
    assert behind(out, failed) <= left

    count = len(calls(out))
    monkeypatch.delenv("CM_FAIL")
    run_flow(out, VIVADO, 1, lambda _: None)
    assert sorted(calls(out)[count:]) == sorted(left)
    assert set(states(out).values()) == {State.DONE}
    assert Flow(out).unfinished() == []


def test_a_flow_that_failed_is_not_collected(
    out: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    schema = str(out.parent / "build.yaml")
    monkeypatch.setenv("CM_FAIL", "bitstreams_run_3")
    assert main(["build", "run", schema, "--vivado", str(FAKE), "-j1"]) == 1
    assert "step bitstreams_run_3 failed" in capsys.readouterr().err
    assert main(["build", "collect", "--schema", schema, "-o", str(out / "target")]) == 1
    assert f"the flow in {out} is not finished, bitstreams_run_3 must run" in capsys.readouterr().err
    assert not (out / "target").exists()


@pytest.mark.parametrize("step", ["system", "run_1", "bitstreams_run_1"])
def test_an_interrupted_flow_ends_its_programs_and_goes_on_there(
    out: Path, step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CM_HANG", step)
    pid = out.parent.parent / "calls.pid"

    def interrupt(sentence: str) -> None:
        if sentence.startswith(f"{step}: "):
            _until(lambda: pid.exists() and pid.read_text().endswith("\n"))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_flow(out, VIVADO, 1, interrupt)
    number = int(pid.read_text())
    _until(lambda: not _alive(number))
    assert states(out)[step] is State.NEW
    monkeypatch.delenv("CM_HANG")
    done = {name for name, state in states(out).items() if state is State.DONE}
    count = len(calls(out))
    run_flow(out, VIVADO, 1, lambda _: None)
    assert sorted(calls(out)[count:]) == sorted(set(STEPS) - done)


def _until(true: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[-1].split()[0] != "Z"
    except OSError:
        return False


def test_several_failures_at_once_are_all_reported(out: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Vivado without a licence fails in every step that make has begun."""
    program = tmp_path / "broken.sh"
    program.write_text(
        "#!/bin/sh\n"
        ": > $CM_CALLS.$$\n"  # each waits for the other to have begun
        "for i in $(seq 1000); do set -- $CM_CALLS.*; [ $# -ge 2 ] && break; sleep 0.01; done\n"
        "echo \"ERROR: [Common 17-345] A valid license was not found for feature 'Synthesis'\"\n"
        "exit 1\n"
    )
    program.chmod(0o755)
    with pytest.raises(StepFailed) as failure:
        run_flow(out, Vivado(program, (2023, 2)), 2, lambda _: None)
    text = str(failure.value)
    assert text.count("A valid license was not found") == 2
    assert f"{out}/logs/system.out says" in text


def test_outdated_results_of_the_flow_are_not_collected(out: Path, capsys: pytest.CaptureFixture) -> None:
    """A changed module leaves old bitstreams behind: they are not collected together with new ones."""
    schema = str(out.parent / "build.yaml")
    run_flow(out, VIVADO, 1, lambda _: None)
    source = out.parent / "hdl/camera_edge.v"
    source.write_text(source.read_text() + "// changed\n")
    assert main(["build", "collect", "--schema", schema]) == 1
    assert "synth_edge, run_2, verify" in capsys.readouterr().err


def test_a_flow_that_was_generated_from_other_input_is_not_run(out: Path, capsys: pytest.CaptureFixture) -> None:
    schema = out.parent / "build.yaml"
    schema.write_text(schema.read_text().replace("board: pynq-z2", "board: zybo-z7-20"))
    assert main(["build", "run", str(schema), "--vivado", str(FAKE)]) == 1
    assert "would be generated otherwise now: run cm build generate first" in capsys.readouterr().err
    assert calls(out) == []
    assert main(["build", "run", str(schema), "--dry-run"]) == 0
    assert "note: " in capsys.readouterr().out


def test_generated_files_that_the_user_changed_are_run(out: Path) -> None:
    path = out / "tcl/floorplan.tcl"
    path.write_text(path.read_text() + "# mine\n")
    assert main(["build", "run", str(out.parent / "build.yaml"), "--vivado", str(FAKE)]) == 0
    assert (out / "bitstreams/edge.bin").stat().st_size

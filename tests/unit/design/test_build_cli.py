# SPDX-License-Identifier: Apache-2.0
"""`cm build check` and `cm build generate` at the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from build_support import EXAMPLES, MINIMAL, STREAM_MODULE, copy_examples, project
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cm.cli.main import main
from cm.design.project.load import load_project
from cm.schema import Problem, SchemaError

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")


def test_check_tells_interfaces_fits_and_runs(capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", str(EXAMPLES / "two_regions/build.yaml")]) == 0
    said = capsys.readouterr().out
    assert "  s_axis: axis slave, 32 bits" in said
    assert "  frame_done: interrupt" in said
    assert "  invert: adapted: s_axi: answered with SLVERR" in said
    assert "3 implementation runs (the fewest possible)" in said


def test_check_as_json(capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", "--json", str(EXAMPLES / "camera/build.yaml")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["fewest"] == {"runs": 3, "bound": 3, "proved": True}
    ports = {interface["name"]: interface["ports"] for interface in found["modules"]["edge"]["interfaces"]}
    assert ports["s_axis"]["TDATA"] == "s_axis_tdata"
    assert found["regions"]["prr0"]["modules"]["edge"] == {"fits": True, "adapted": [], "notes": [], "refused": []}


def test_check_fails_where_a_module_does_not_fit(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = project(tmp_path, MINIMAL + "  two: {sources: [two.v]}\n", two=STREAM_MODULE.format(name="two", high=7))
    assert main(["build", "check", str(path)]) == 1
    assert "refused" in capsys.readouterr().out


def test_a_mistake_in_the_schema_ends_every_command(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = project(tmp_path, MINIMAL.replace("pblock", "pblok"))
    for action in ("check", "generate", "run", "partition"):
        assert main(["build", action, str(path)]) == 1
        assert f"{path}:3:10: regions.prr0.pblok: unknown key 'pblok' (did you mean pblock?)" in capsys.readouterr().err


def test_without_a_build_schema_it_is_said_what_writes_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["build", "check"]) == 1
    assert "build.yaml:1:1: cannot be read: No such file or directory (cm build init FILE…" in capsys.readouterr().err


def test_a_mode_cannot_change_a_stream_that_does_not_exist(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    schema = copy_examples(tmp_path) / "camera/build.yaml"
    schema.write_text(schema.read_text().replace("streams: {camera:", "streams: {camra:"))
    assert main(["build", "generate", str(schema)]) == 1
    assert "mode colorise names the stream 'camra' (did you mean camera?)" in capsys.readouterr().err
    assert not (tmp_path / "camera/build/config").exists()


def test_generate_says_what_it_did_and_fails_on_a_conflict(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    schema = copy_examples(tmp_path) / "camera/build.yaml"
    assert main(["build", "generate", str(schema)]) == 0
    changed = tmp_path / "camera/build/config/camera.yaml"
    changed.write_text(changed.read_text() + "# mine\n")
    schema.write_text(schema.read_text().replace("max: 15", "max: 14"))
    capsys.readouterr()
    assert main(["build", "generate", str(schema)]) == 1
    said = capsys.readouterr().out
    assert "changed by you and by generation: config/camera.yaml" in said
    assert (tmp_path / "camera/build/config/camera.yaml.new").exists()
    assert changed.read_text().endswith("# mine\n")


def test_answers_that_no_longer_fit_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = project(tmp_path)
    (tmp_path / "build").mkdir()
    (tmp_path / "build/answers.yaml").write_text("default_mode: gone\n")
    assert main(["build", "generate", str(path)]) == 1
    assert "answers.yaml" in capsys.readouterr().err
    assert not (tmp_path / "build/config").exists()


LINES = (EXAMPLES / "camera/build.yaml").read_text().splitlines()


def problems_of(path: Path) -> tuple[Problem, ...]:
    try:
        load_project(path)
    except SchemaError as error:
        return error.problems
    return ()


@given(data=st.data())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_damage_to_a_schema_is_reported_or_harmless(data: st.DataObject, tmp_path: Path) -> None:
    lines = list(LINES)
    for _ in range(data.draw(st.integers(1, 3))):
        index = data.draw(st.integers(0, len(lines) - 1))
        lines[index] = data.draw(st.sampled_from(["", "- x", "  a: [", lines[index].replace(":", ""), "x: 1", "{}"]))
    path = tmp_path / "build.yaml"
    path.write_text("\n".join(lines))
    for problem in problems_of(path):
        assert problem.message
        assert problem.line >= 1


@given(text=st.text())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_is_a_schema_or_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "build.yaml"
    path.write_text(text, errors="replace")
    assert all(problem.path == path for problem in problems_of(path))

# SPDX-License-Identifier: Apache-2.0
"""What the advisor proposes is a build schema that can be checked and generated."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
import yaml
from build_support import NAMES, STREAM_MODULE, copy_examples, project

pytest.importorskip("scipy", reason="needs scipy: the extra [build] is not installed")
pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
pytest.importorskip("jinja2", reason="needs jinja2: the extra [build] is not installed")

from cm.cli.main import main
from cm.design.plan.system import System
from cm.design.project.source_position import Finding


def proposed(path: Path, *options: str) -> dict[str, dict[str, dict[str, object]]]:
    """Return the proposal's data, once it has passed `check` and been generated."""
    out = path.with_name("proposed.yaml")
    assert main(["build", "partition", str(path), "-o", str(out), *options]) == 0
    assert main(["build", "check", str(out)]) == 0
    assert main(["build", "generate", str(out), "--out", str(path.with_name("proposed"))]) == 0
    data: dict[str, dict[str, dict[str, object]]] = yaml.safe_load(out.read_text(encoding="utf-8"))
    return data


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("budget", ["4", "5", "60"])
def test_a_proposal_for_a_shipped_example_is_generated(tmp_path: Path, name: str, budget: str) -> None:
    proposed(copy_examples(tmp_path) / name / "build.yaml", "--budget", budget)


def test_modules_on_the_same_pins_stay_in_one_region(tmp_path: Path) -> None:
    # there is room for each in its own region, but the sensor is in one place only
    assert list(proposed(copy_examples(tmp_path) / "camera" / "build.yaml")["regions"]) == ["prr0"]


def test_a_region_that_is_divided_gives_each_stream_its_own_name(tmp_path: Path) -> None:
    data = proposed(copy_examples(tmp_path) / "two_regions" / "build.yaml", "--budget", "5")
    streams = [spec["stream"] for region in data["regions"].values() for spec in region["interfaces"].values()
               if "stream" in spec]  # fmt: skip
    assert len(streams) == len(set(streams)) == 6
    assert data["regions"]["filter"]["pblock"] == ["proven:pr_1"]
    assert data["modes"]["plain"]["modules"] == {"filter": "default", "correction_2": "gain"}


MERGED = """\
project: {name: merged, part: xc7z020clg400-1}
regions:
  left: {interfaces: {s_axis: {stream: in, shape: [4, 4]}, m_axis: {stream: out, shape: [16]}}, window: 0x20000}
  right: {interfaces: {s_axis: {stream: right_in, shape: [8, 8]}, m_axis: {shape: [16]}}}
modules:
  one: {sources: [one.v], regions: [left, right], resources: {lut: 5000}}
  two: {sources: [two.v], regions: [right], resources: {lut: 5000}}
modes:
  a: {modules: {left: one}}
  b: {modules: {right: two}}
  c: {modules: {right: one}, streams: {right_in: {shape: [2, 2], dtype: uint32}}}
default_mode: b
"""


def test_regions_that_become_one_keep_the_frames_of_each_mode(tmp_path: Path) -> None:
    path = project(tmp_path, MERGED, two=STREAM_MODULE.format(name="two", high=31))
    data = proposed(path, "--regions", "1")
    assert list(data["regions"]) == ["left"]
    assert data["regions"]["left"]["window"] == 0x20000
    assert data["regions"]["left"]["resources"] == {"lut": 5000}
    assert "regions" not in data["modules"]["one"]
    shapes = {name: mode.get("streams") for name, mode in data["modes"].items()}
    assert shapes == {
        "a": None,
        "b": {"in": {"shape": [8, 8]}},
        "c": {"in": {"shape": [2, 2], "dtype": "uint32"}},
    }


def test_a_proposal_that_cannot_be_generated_is_replaced_by_one_with_fewer_regions(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_most_three(system: System) -> list[Finding]:
        return [Finding("full", ("regions",), "three is the limit")] if len(system.regions) > 3 else []

    monkeypatch.setattr("cm.design.partition.proposal.check_system", at_most_three)
    text = "project: {name: many, part: xc7z020clg400-1}\nregions: {prr0: {}}\nmodules:\n"
    names = [f"m{index}" for index in range(6)]
    text += "".join(f"  {name}: {{sources: [{name}.v], resources: {{lut: 900}}}}\n" for name in names)
    files = {name: STREAM_MODULE.format(name=name, high=31) for name in names}
    data = proposed(project(tmp_path, text, **files), "--objective", "mean")
    assert len(data["regions"]) == 3
    assert "note: 6 regions cannot be generated: three is the limit [full]" in capsys.readouterr().out


def test_a_proposal_with_an_impossible_block_design_is_replaced_too(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    # forty streams with an engine each have more masters than the ports to memory take
    text = "project: {name: many, part: xc7z020clg400-1}\nregions: {prr0: {}}\nmodules:\n"
    names = [f"m{index}" for index in range(20)]
    text += "".join(f"  {name}: {{sources: [{name}.v], resources: {{lut: 900}}}}\n" for name in names)
    files = {name: STREAM_MODULE.format(name=name, high=31) for name in names}
    data = proposed(project(tmp_path, text, **files), "--objective", "mean")
    assert 1 < len(data["regions"]) < 20
    assert "note: 20 regions cannot be generated: " in capsys.readouterr().out


def test_a_region_that_stays_but_is_too_small_is_placed_anew(tmp_path: Path) -> None:
    path = copy_examples(tmp_path) / "camera" / "build.yaml"
    path.write_text(path.read_text(encoding="utf-8").replace("{lut: 335,", "{lut: 5000,"), encoding="utf-8")
    region = proposed(path)["regions"]["prr0"]
    assert (region["pblock"], region["resources"]["lut"]) == (["auto"], 5000)


def test_thirty_modules_twenty_modes_and_four_slots_are_proposed_and_generated(tmp_path: Path) -> None:
    draw = random.Random(3)
    names = [f"m{index}" for index in range(30)]
    slots = [names[slot::4] for slot in range(4)]
    modules = "".join(
        f"  {name}: {{sources: [{name}.v], regions: [r{index % 4}], resources: {{lut: {draw.randint(300, 4000)}}}}}\n"
        for index, name in enumerate(names)
    )
    modes = "".join(
        f"  mode{index}: {{modules: {{{', '.join(f'r{n}: {draw.choice(slot)}' for n, slot in enumerate(slots))}}}}}\n"
        for index in range(20)
    )
    text = "project: {name: thirty, part: xc7z020clg400-1}\nregions: {r0: {}, r1: {}, r2: {}, r3: {}}\n"
    text += f"modules:\n{modules}modes:\n{modes}"
    files = {name: STREAM_MODULE.format(name=name, high=31) for name in names}
    data = proposed(project(tmp_path, text, **files), "--regions", "4", "--seconds", "300")
    assert len(data["regions"]) == 4
    assert len(data["modes"]) == 20


def test_a_proposal_lies_beside_the_build_schema_and_replaces_no_file(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = copy_examples(tmp_path) / "camera" / "build.yaml"
    assert main(["build", "partition", str(path), "-o", str(tmp_path / "x.yaml")]) == 1
    assert "must lie in" in capsys.readouterr().err
    assert main(["build", "partition", str(path), "-o", str(path)]) == 1
    assert "exists already" in capsys.readouterr().err

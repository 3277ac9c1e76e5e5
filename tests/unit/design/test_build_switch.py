# SPDX-License-Identifier: Apache-2.0
"""The stream switch in the build schema: what is refused, with its place, and what the runtime schema says."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import STREAM_MODULE, needs, project
from test_build_tcl import replay, scripts

from cm import schema
from cm.cli.main import main
from cm.design.check.rules import check_system
from cm.design.errors import BuildError
from cm.design.generate.generation import Design, generate, load_design, output_folder
from cm.schema import SchemaError

CHAIN = """\
project: {name: chain, part: xc7z020clg400-1}
clocks: {fclk0: {rate: 100_000_000}, slow: {rate: 50_000_000}}
switch:
  inputs: {into: {shape: [48]}}
  outputs: {out: {shape: [48]}}
regions:
  left: {interfaces: {s_axis: {connect: switch}, m_axis: {connect: switch}}}
  right: {interfaces: {s_axis: {connect: switch}, m_axis: {connect: switch}}}
modules:
  one: {sources: [one.v], regions: [left]}
  other: {top: one, sources: [one.v], regions: [right]}
modes:
  both:
    modules: {left: one, right: other}
    routes: {left.s_axis: into, right.s_axis: left.m_axis, out: right.m_axis}
  short:
    modules: {left: one, right: other}
    routes: {left.s_axis: into, out: left.m_axis}
"""


def built(folder: Path, text: str = CHAIN, **files: str) -> tuple[Design, Path]:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    design = load_design(project(folder, text, **files))
    out = output_folder(design.project, None)
    generate(design, out)
    return design, out


def test_a_modes_routes_are_values_of_the_switchs_registers_and_the_update_comes_last(tmp_path: Path) -> None:
    design, out = built(tmp_path)
    config = schema.load(out / "config/chain.yaml")
    base = design.system.switch.window.base if design.system.switch else 0
    both, short = (dict(config.modes[m].registers.items()) for m in ("both", "short"))
    names = ["route_out", "route_left_s_axis", "route_right_s_axis", "route_update"]
    assert list(both) == names
    assert [r.address - base for r in both.values()] == [0x40, 0x44, 0x48, 0]
    assert [r.default for r in both.values()] == [2, 0, 1, 0x102]
    assert [r.default for r in short.values()] == [1, 0, 0x8000_0000, 0x202]


def test_streams_of_the_switch_say_what_they_pass_through_so_that_they_stop_when_that_changes(tmp_path: Path) -> None:
    config = schema.load(built(tmp_path)[1] / "config/chain.yaml")
    streams = {mode: config.modes[mode].streams for mode in ("both", "short")}
    assert streams["both"]["into"].doc == "through left (one), right (other)"
    assert (streams["both"]["out"].region, streams["short"]["out"].region) == ("right", "left")
    assert streams["both"]["into"] != streams["short"]["into"]


@needs("tclsh")
def test_a_design_with_a_switch_has_no_finding_and_replays(tmp_path: Path) -> None:
    design, out = built(tmp_path / "p" if (tmp_path / "p").mkdir() is None else tmp_path)
    assert [finding for finding in check_system(design.system) if finding.error] == []
    assert len(design.system.engines) == 3
    status, said, _ = replay(out, scripts(out)[0], tmp_path)
    assert status == 0, said


def test_check_lists_the_switch_with_the_routes_of_each_mode(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["build", "check", str(project(tmp_path, CHAIN))]) == 0
    said = capsys.readouterr().out
    assert "switch: 3 sources, 3 sinks, 32 bits, registers at 0x40001000, on fclk0" in said
    assert "  both: into → left.s_axis, left.m_axis → right.s_axis, right.m_axis → out" in said
    assert "  s_axis: axis slave, 32 bits\n" in said


def test_the_switch_is_a_device_of_the_static_overlay(tmp_path: Path) -> None:
    design, out = built(tmp_path)
    assert design.system.switch
    node = f"cm_switch: cm-switch@{design.system.switch.window.base:x} {{"
    assert node in (out / "dts/chain_static.dtso").read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("out: right.m_axis}", "outt: right.m_axis}", "modes.both.routes.outt: the switch has no sink 'outt' (did you"),
        ("left.s_axis: into, right", "left.s_axis: in, right", "routes.left.s_axis: the switch has no source 'in'"),
        ("out: right.m_axis", "out: left.m_axis", "routes.out: left.m_axis goes to right.s_axis already"),
        ("right: {interfaces", "right: {clock: slow, interfaces", "right runs on slow, the switch on fclk0"),
        ("switch:\n", "switch:\n  clock: fast\n", "switch.clock: there is no clock 'fast'"),
        ("outputs: {out:", "outputs: {into:", "into is an input too"),
        ("inputs: {into: {shape: [48]}}", "inputs: {into: {shape: [50]}}", "into at left_s_axis: a frame of 50 uint8"),
    ],
)
def test_a_mistake_at_the_switch_is_reported_with_its_place(old: str, new: str, said: str, tmp_path: Path) -> None:
    assert old in CHAIN
    with pytest.raises((BuildError, SchemaError)) as caught:
        built(tmp_path, CHAIN.replace(old, new, 1))
    assert said in str(caught.value)
    assert "build.yaml:" in str(caught.value)


def test_routes_and_connections_without_a_switch_are_refused(tmp_path: Path) -> None:
    without = CHAIN[: CHAIN.index("switch:\n")] + CHAIN[CHAIN.index("regions:") :]
    with pytest.raises(SchemaError, match=r"modes\.both\.routes: there is no switch \(write switch: at the top\)"):
        built(tmp_path, without)
    text = without.split("modes:")[0]
    with pytest.raises(BuildError, match=r"left\.s_axis goes to the switch, and there is none"):
        built(tmp_path, text)


def test_a_stream_without_an_end_cannot_go_to_the_switch(tmp_path: Path) -> None:
    source = STREAM_MODULE.format(name="one", high=31).replace("    assign m_axis_tlast = s_axis_tlast;\n", "")
    source = source.replace(",\n    output wire        m_axis_tlast", "")
    with pytest.raises(BuildError, match=r"left\.m_axis has no TLAST"):
        built(tmp_path, one=source)


def test_more_streams_than_the_switch_has_ports_are_refused(tmp_path: Path) -> None:
    regions = "".join(
        f"  r{i}: {{interfaces: {{s_axis: {{connect: switch}}, m_axis: {{connect: switch}}}}}}\n" for i in range(16)
    )
    names = ", ".join(f"r{i}" for i in range(16))
    text = (
        CHAIN[: CHAIN.index("regions:")]
        + f"regions:\n{regions}modules:\n  one: {{sources: [one.v], regions: [{names}]}}\n"
    )
    with pytest.raises(BuildError, match=r"switch: the switch has 17 sources"):
        built(tmp_path, text)

# SPDX-License-Identifier: Apache-2.0
"""Mistakes in a build schema and in HDL: each error has file, line, what is wrong and what would be right."""

from __future__ import annotations

from pathlib import Path

import pytest
from build_support import AXIL_MODULE, STREAM_MODULE

from cm.cli.main import main

pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")

SCHEMA = """\
project: {name: small, part: xc7z020clg400-1}
clocks:
  fclk0: {rate: 100_000_000}
regions:
  prr0:
    pblock: auto
    clock: fclk0
    interfaces:
      s_axis: {stream: src}
      m_axis: {stream: dst}
modules:
  one: {sources: [one.v]}
  two: {sources: [two.v]}
modes:
  first: {modules: [one]}
  second: {modules: [two]}
"""
ONE = STREAM_MODULE.format(name="one", high=31)
TWO = STREAM_MODULE.format(name="two", high=31)
ONE_LINE = "one: {sources: [one.v]}"


def told(folder: Path, schema: str, capsys: pytest.CaptureFixture, **files: str) -> str:
    """Return what ``cm build check`` prints, with paths relative to the folder; it must fail."""
    for name, text in ({"one.v": ONE, "two.v": TWO} | files).items():
        (folder / name).write_text(text)
    (folder / "build.yaml").write_text(schema)
    assert main(["build", "check", str(folder / "build.yaml")]) == 1
    said = capsys.readouterr()
    return (said.out + said.err).replace(f"{folder}/", "")


def changed(*pairs: tuple[str, str]) -> str:
    text = SCHEMA
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("xc7z020clg400-1", "xc7a35tcsg324-1", "1:24: project.part: xc7a35tcsg324-1 is not part of the Zynq-7000"),
        ("xc7z020clg400-1", "xc7z020", "1:24: project.part: 'xc7z020' does not fit (Full part, e.g. xc7z020clg400-1. "),
        (
            "400-1}",
            "400-1, board: zcu104}",
            "1:24: project.part: AMD ZCU104 has xczu7ev-ffvc1156-2-e, not xc7",
        ),
        ("400-1}", "400-1, board: zcu14}", "1:47: project.board: there is no board 'zcu14' (did you mean zcu104"),
        (
            "400-1}",
            "400-1, board: 'a:b'}",
            "1:47: project.board: 'a:b' does not fit (A board of the library, e.g. pynq",
        ),
        (", part: xc7z020clg400-1", "", "1:1: project: part is missing (or name a board of the library)"),
        ("pblock: auto", "pblock: 'proven:x'", "6:5: regions.prr0.pblock[0]: there is no pblock of the board 'x'"),
        ("400-1}", "400-1, vivado: latest}", "1:47: project.vivado: 'latest' does not fit (The only version"),
        ("100_000_000", "250_000_000", "3:11: clocks.fclk0.rate: the ICAP runs on fclk0 at 250000000 Hz; zynq7000 all"),
        (
            "pblock: auto",
            "pblock: slice",
            "6:5: regions.prr0.pblock[0]: 'slice' does not fit (auto, proven:NAME, or a",
        ),
        (
            "pblock: auto",
            "pblock: SLICE_X9Y9:SLICE_X0Y0",
            "6:5: regions.prr0.pblock[0]: SLICE_X9Y9:SLICE_X0Y0 does not begin at its lower left end (write "
            "SLICE_X0Y0:SLICE_X9Y9)",
        ),
        ("pblock: auto", "pblock: [SLICE_X0Y0:DSP48_X1Y1]", "is from SLICE to DSP48 (both ends are sites of one kind)"),
        ("pblock: auto", "pblock: [auto, SLICE_X0Y0:SLICE_X1Y1]", "6:14: regions.prr0.pblock[0]: auto is combined"),
        ("clock: fclk0", "clock: fclk9", "7:5: regions.prr0.clock: there is no clock 'fclk9' (did you mean fclk0?)"),
        ("clock: fclk0", "window: 5000", "7:5: regions.prr0.window: 0x1388 is not a power of two (write 0x2000)"),
        ("clock: fclk0", "clock: fclk0\n    clock: fclk0", "8:5: regions.prr0.clock: clock is here again (it is in li"),
        ("    clock: fclk0", "\tclock: fclk0", "7:1: not YAML: found a tab character"),
        (
            "stream: dst",
            "stream: src",
            "10:16: regions.prr0.interfaces.m_axis.stream: src is the stream of prr0.s_axis",
        ),
        (
            "m_axis: {",
            "m_axsi: {",
            "10:7: regions.prr0.interfaces.m_axsi: region prr0 has no interface 'm_axsi' (did y",
        ),
        (
            "{stream: dst}",
            "{connect: memory}",
            "10:16: regions.prr0.interfaces.m_axis.connect: prr0.m_axis (axis master) cannot be connected to memory "
            "(write dma or vdma or switch or external or none)",
        ),
        ("{stream: dst}", "{connect: dam}", "m_axis.connect: 'dam' is not one of dma, vdma, switch, interconnect"),
        ("dst}", "dst, dtype: unit8}", "10:29: regions.prr0.interfaces.m_axis.dtype: 'unit8' is not one of bool"),
        ("dst}", "dst, shape: [0]}", "interfaces.m_axis.shape[0]: 0 is out of range (at least 1)"),
        ("[two.v]", "[tow.v]", "13:19: modules.two.sources[0]: tow.v does not exist (looked in "),
        ("[two.v]}", "[two.v], top: tow}", "13:27: modules.two.top: no module tow in two.v; there are: two"),
        (
            "[two.v]}",
            "[two.v], regions: [prr1]}",
            "modules.two.regions[0]: there is no region 'prr1' (did you mean prr0",
        ),
        (
            "[two.v]}",
            "[two.v], parameters: {W: 4}}",
            "13:40: modules.two.parameters.W: no parameter W in two; there ar",
        ),
        (
            "[two.v]}",
            "[two.v], registers: {a: {offset: 0}, b: {offset: 2, width: 16}}}",
            "modules.two.registers.b: b overlaps a (a is at 0x0, 32 bits)",
        ),
        (
            "[two.v]}",
            "[two.v], registers: {a: {offset: 0, fields: {x: {lsb: 3, bits: 3}, y: }}}}",
            "modules.two.registers.a.fields.y: where is the field? (either bits, or lsb and width)",
        ),
        (
            "[two.v]}",
            "[two.v], defines: [WIDE]}",
            "defines: expected a map, found a list (Macros of the preprocessor, ",
        ),
        ("[two.v]}", "[two.v], resources: {LUT: 4}}", "two.resources.LUT: unknown key 'LUT' (did you mean lut?)"),
        ("[two.v]}", "[two.v], registers: {a: {offset: 3}}}", "registers.a.offset: offset 0x3 is not a multiple of 4"),
        (
            "[two.v]}",
            "[two.v], registers: {a: {offset: 0}}}",
            "13:27: modules.two.registers: two has registers, and region prr0 has no register interface",
        ),
        ("[two.v]}", "[two.v], register_map: one.v}", "13:27: modules.two.register_map: "),
        ("[two.v]}", "[two.v], component: one.v}", "13:27: modules.two.component: "),
        ("modules: [two]", "modules: [tow]", "16:12: modes.second.modules.tow: there is no module 'tow' (did you mean"),
        (
            "modules: [two]",
            "modules: {prr1: two}",
            "16:22: modes.second.modules.prr1: there is no region 'prr1' (did y",
        ),
        ("modules: [two]", "modules: [one, two]", "16:12: modes.second.modules: one and two both go to prr0 (a region"),
        ("[two]}", "[two], registers: {thr: 4}}", "16:40: modes.second.registers.thr: there is no register 'thr' (the"),
        (
            "[two]}",
            "[two], streams: {sr: {dtype: int8}}}",
            "modes.second.streams.sr: mode second names the stream 'sr'",
        ),
    ],
)
def test_a_mistake_in_the_schema_is_reported_with_its_place(
    old: str, new: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    said = told(tmp_path, changed((old, new)), capsys)
    assert sentence in said
    assert "build.yaml:" in said


def test_the_error_for_an_empty_schema_says_how_to_begin(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert "build.yaml:1:1: the file is empty (begin with project:" in told(tmp_path, "", capsys)


@pytest.mark.parametrize(
    ("one", "sentence"),
    [
        (ONE.replace("clk,", "clk"), "problem: one.v:2: expected ','"),
        ('`include "defs.vh"\n' + ONE, "one.v:1: 'defs.vh': No such file or directory: name its folder (include_dirs:"),
        (ONE.replace("[31:0]", "[`W-1:0]"), "one.v:4: unknown macro or compiler directive '`W': define it (defines:, "),
        (
            ONE.replace("endmodule", "reg r; always @(posedge clk) if (r = 1) r <= 0;\nendmodule"),
            "assignment expressions must be parenthesized: == compares\n",
        ),
        ("// nothing\n", "build.yaml:12:9: modules.one.sources: no module and no entity in one.v"),
        ("entity one is\nend;\n", "build.yaml:12:9: modules.one.sources: no module and no entity in one.v: one.v:1: "),
        (
            STREAM_MODULE.format(name="one", high=7),
            "one.v:4: s_axis.TDATA has 8 bits, the region's s_axis 32: its data",
        ),
        (
            ONE.replace(",\n    output wire        m_axis_tlast", ""),
            "one.v:8: m_axis drives no TLAST, which other modul",
        ),
        (
            ONE.replace("output wire        s_axis_tready", "input wire s_axis_tready"),
            "one.v:6: port s_axis_tready looks",
        ),
        (ONE.replace("resetn,", "resetn,\n    inout wire sda,"), "one.v:4: port sda is bidirectional: use separate"),
        (
            ONE.replace("one (", "one #(parameter W) (").replace("31:0", "W-1:0"),
            "one.v:4: port s_axis_tdata: its range",
        ),
    ],
)
def test_a_mistake_in_hdl_is_reported_with_its_place(
    one: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert sentence in told(tmp_path, SCHEMA, capsys, **{"one.v": one})


def test_a_syntax_error_in_a_file_below_the_top_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    top = ONE.replace("endmodule", "below b (.clk(clk));\nendmodule")
    schema = changed((ONE_LINE, "one: {sources: [one.v, below.v]}"))
    said = told(tmp_path, schema, capsys, **{"one.v": top, "below.v": "module below (input clk);\nwire x\nendmodule\n"})
    assert "problem: below.v:2: expected ';'" in said or "problem: below.v:3: expected ';'" in said
    assert "1 problem that synthesis will stop at" in said


def test_a_build_schema_in_another_encoding_is_named_with_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    path = tmp_path / "build.yaml"
    path.write_bytes((SCHEMA + "# Größe\n").encode("latin-1"))
    assert main(["build", "check", str(path)]) == 1
    assert "build.yaml:17:1: not UTF-8 text (save the file as UTF-8)" in capsys.readouterr().err


def test_a_runtime_schema_and_a_folder_in_its_place_are_told_what_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "build.yaml").write_text(SCHEMA)
    (tmp_path / "run.yaml").write_text("config: {name: c, modes: {default: {}}}\n")
    assert main(["build", "check", str(tmp_path / "run.yaml")]) == 1
    assert "unknown key 'config' (this is a runtime schema: cm config check)" in capsys.readouterr().err
    assert main(["config", "check", str(tmp_path / "build.yaml")]) == 1
    said = capsys.readouterr()
    assert "unknown key 'project' (this is a build schema: cm build check)" in said.out + said.err
    (tmp_path / "build.yaml").unlink()
    assert main(["build", "check", str(tmp_path)]) == 1
    assert f"{tmp_path / 'build.yaml'}:1:1: cannot be read: No such file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("pins.xdc", "write it under constraints:"),
        ("rom.mem", "it lies beside the file that reads it, and is not listed"),
        ("design.BD", "name the files that it is made of"),
        ("design.hwh", "it describes a whole design: cm import takes it, and register_map: its registers"),
        ("README.md", "leave it out"),
    ],
)
def test_a_file_that_is_no_hdl_is_no_source(name: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    said = told(tmp_path, changed(("[two.v]", f"[two.v, {name}]")), capsys, **{name: "x\n"})
    assert f"modules.two.sources: {name} is no HDL: {why}" in said
    assert main(["build", "init", str(tmp_path / "one.v"), str(tmp_path / name), "-o", str(tmp_path / "new.yaml")]) == 1


def test_two_modules_of_one_name_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "again.v").write_text(ONE)
    for name, text in (("one.v", ONE), ("two.v", TWO)):
        (tmp_path / name).write_text(text)
    (tmp_path / "build.yaml").write_text(changed((ONE_LINE, "one: {sources: [one.v, again.v]}")))
    assert main(["build", "check", str(tmp_path / "build.yaml")]) == 0
    assert "again.v: module one is declared in" in capsys.readouterr().out


def test_a_broken_register_description_is_reported_with_its_line(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    pytest.importorskip("systemrdl", reason="needs systemrdl-compiler: the extra [build] is not installed")
    (tmp_path / "map.rdl").write_text("addrmap a {\n  reg { nonsense\n")
    schema = changed((ONE_LINE, "one: {sources: [one.v], register_map: map.rdl}"))
    said = told(tmp_path, schema, capfd, **{"one.v": AXIL_MODULE})
    assert "build.yaml:12:27: modules.one.register_map: map.rdl:2:17: error: " in said
    assert said.count("error:") == 1


def test_generate_tells_problems_too(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    for name, text in (("one.v", ONE.replace("clk,", "clk")), ("two.v", TWO)):
        (tmp_path / name).write_text(text)
    (tmp_path / "build.yaml").write_text(SCHEMA)
    assert main(["build", "generate", str(tmp_path / "build.yaml")]) == 0
    assert "problem of one: " in capsys.readouterr().out


def test_what_a_misspelt_key_has_no_part_in_is_reported_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    schema = changed(
        ("clock: fclk0", "clk: fclk0"), ("[two.v]}", "[tow.v]}"), ("[one]", "[oen]"), ("{modules: [two]}", "[]")
    )
    lines = told(tmp_path, schema + "default_mode: third\n", capsys).splitlines()
    assert [line.removeprefix("cm: ").removeprefix("build.yaml:").partition(" (")[0] for line in lines] == [
        "7:5: regions.prr0.clk: unknown key 'clk'",
        "13:19: modules.two.sources[0]: tow.v does not exist",
        "15:11: modes.first.modules.oen: there is no module 'oen'",
        "16:11: modes.second: modules is missing",
        "17:1: default_mode: there is no mode 'third' [schema_invalid]",
    ]

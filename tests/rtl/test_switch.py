# SPDX-License-Identifier: Apache-2.0
"""The stream switch: clean under lint for any number of ends, byte-exact chains, registers as PG085 has them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from build_support import project
from conftest import HERE, needs, served
from simulation import simulate
from test_shared_engines import adder, lint

import cm
from cm.design.generate.generation import generate, load_design, output_folder

RTL = HERE.parent.parent / "cm" / "design" / "rtl"
CHAIN = """\
project: {name: chain, part: xc7z020clg400-1}
switch:
  inputs: {to_chain: {shape: [48]}}
  outputs: {from_chain: {shape: [48]}}
regions:
  left: {interfaces: {s_axis: {connect: switch}, m_axis: {connect: switch}}}
  right: {interfaces: {s_axis: {connect: switch}, m_axis: {connect: switch}}}
modules:
  m0: {sources: [m0.v], regions: [left]}
  m2: {sources: [m2.v], regions: [right]}
modes:
  both:
    modules: {left: m0, right: m2}
    routes: {left.s_axis: to_chain, right.s_axis: left.m_axis, from_chain: right.m_axis}
  turned:
    modules: {left: m0, right: m2}
    routes: {right.s_axis: to_chain, left.s_axis: right.m_axis, from_chain: left.m_axis}
  alone: {modules: {left: m0}, routes: {left.s_axis: to_chain, from_chain: left.m_axis}}
  straight: {modules: {left: m0}, routes: {from_chain: to_chain}}
"""


@needs("verilator")
@pytest.mark.parametrize("sources", [1, 3, 16])
@pytest.mark.parametrize("sinks", [1, 2, 16])
def test_a_switch_of_any_size_is_clean(sources: int, sinks: int) -> None:
    sizes = (f"-GSOURCES={sources}", f"-GSINKS={sinks}", "-GBYTES=4")
    lint("--top-module", "cm_axis_switch", *sizes, "-y", RTL, RTL / "cm_axis_switch.v")


@needs("iverilog")
@needs("verilator")
@pytest.mark.timeout(600)
@pytest.mark.parametrize("engine", ["", ", engine: all"])
def test_chains_of_two_regions_are_byte_exact_and_change_by_registers(engine: str, tmp_path: Path) -> None:
    text = CHAIN.replace("shape: [48]", f"shape: [48]{engine}")
    design = load_design(project(tmp_path, text, m0=adder(0), m2=adder(2)))
    out = output_folder(design.project, None)
    generate(design, out)
    hdl = out / "hdl"
    lint("--top-module", "cm_static", "-y", hdl, "-y", hdl / "lib", "-y", HERE / "models", hdl / "cm_static.v")
    sources = [hdl / "cm_static.v", *sorted((hdl / "lib").glob("*.v")), *sorted((HERE / "models").glob("*.v"))]
    for module, region in (("m0", "left"), ("m2", "right")):
        sources += [out / f"wrappers/{module}/cm_region_{region}.v", tmp_path / f"{module}.v"]
    assert len(simulate("cm_static", sources, "cocotb_switch", tmp_path / "sim")) == 6


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    folder = tmp_path_factory.mktemp("chain")
    schema = project(folder, CHAIN, m0=adder(0), m2=adder(2))
    with served(folder, schema, "chain", mode="both") as connected:
        yield connected


@needs("verilator")
@needs("g++")
@pytest.mark.timeout(300)
@pytest.mark.parametrize(("modes", "sums"), [(("both", "turned"), (4, 4)), (("alone", "straight", "both"), (1, 0, 4))])
def test_a_mode_puts_modules_in_a_row_by_the_switchs_registers(
    modes: tuple[str, ...], sums: tuple[int, ...], board: cm.Board
) -> None:
    for mode, total in zip(modes, sums, strict=True):
        board.mode = mode
        with board.stream("from_chain") as out, board.writer("to_chain", timeout=60) as into:
            for number in range(3):
                data = np.arange(number, number + 48, dtype=np.uint8)
                into.write(data)
                assert np.array_equal(out.read(timeout=60), data + np.uint8(total))


@needs("verilator")
@needs("g++")
def test_a_change_of_routes_alone_loads_nothing(board: cm.Board) -> None:
    board.mode = "both"
    steps = [(step.kind, step.subject) for step in board.plan("turned").steps]
    assert "load" not in {kind for kind, _ in steps}
    assert [step for step in steps if step[0] == "registers"][-1] == ("registers", "route_update")

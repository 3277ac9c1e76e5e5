# SPDX-License-Identifier: Apache-2.0
"""What the open flow takes as a clock of registers and memories: the one it times, at the edge that it times."""

from __future__ import annotations

from typing import Any

import pytest

from cm.design.errors import BuildError
from cm.design.openflow.synth import check_clocks

BUFFER = {
    "type": "BUFG",
    "parameters": {},
    "port_directions": {"I": "input", "O": "output"},
    "connections": {"I": ["0"], "O": [2]},
}


def cell(kind: str, pins: dict[str, list[object]], **parameters: str) -> dict[str, Any]:
    directions = {pin: "output" if pin in ("Q", "O") else "input" for pin in pins}
    return {"type": kind, "parameters": parameters, "port_directions": directions, "connections": pins}


def check(**cells: dict[str, Any]) -> None:
    every = {"system.cm_clock_buffer": BUFFER, **cells}
    names = {"$1": {"hide_name": 1, "bits": [5]}, "quotient": {"hide_name": 0, "bits": [6, 7]}}
    check_clocks({"modules": {"top": {"cells": every, "netnames": names}}}, "top", "module one")


def test_everything_on_the_one_clock_is_taken() -> None:
    check(
        a=cell("FDRE", {"C": [2], "CE": ["1"], "R": [9], "Q": [3]}, IS_C_INVERTED="0"),
        b=cell("SRL16E", {"CLK": [2], "CE": [3], "Q": [4]}, IS_CLK_INVERTED="0"),
        c=cell("RAM32M", {"WCLK": [2], "WE": [3]}, IS_WCLK_INVERTED="0"),
        d=cell("RAMB18E1", {"CLKARDCLK": [2], "CLKBWRCLK": ["0"]}),
        e=cell("DSP48E1", {"CLK": [2], "C": [7, 8]}, IS_CLK_INVERTED="0"),
        f=cell("LUT2", {"I0": [3], "I1": [4], "O": [7]}),
    )


@pytest.mark.parametrize(
    "falling",
    [
        cell("FDRE_1", {"C": [2], "Q": [3]}),
        cell("SRLC32E", {"CLK": [2], "Q": [3]}, IS_CLK_INVERTED="1"),
        cell("RAM64M", {"WCLK": [2]}, IS_WCLK_INVERTED="1"),
        cell("RAMB36E1", {"CLKARDCLK": [2]}, IS_CLKARDCLK_INVERTED="1"),
    ],
)
def test_the_falling_edge_is_refused_with_what_to_write(falling: dict[str, Any]) -> None:
    with pytest.raises(BuildError, match=r"module one: late \(\w+\) works at the falling edge: .* always @\(posedge\)"):
        check(late=falling)


def test_a_clock_that_logic_makes_is_refused_with_what_makes_it() -> None:
    half = cell("FDRE", {"C": [2], "Q": [5]})
    with pytest.raises(BuildError, match=r"module one: quotient \(FDCE\) is clocked by half: .*an enable"):
        check(half=half, slow=cell("FDCE", {"C": [5], "Q": [6]}))
    with pytest.raises(BuildError, match="is clocked by a port"):
        check(slow=cell("RAM64X1D", {"WCLK": [5]}))


def test_the_harness_has_a_clock_of_its_own() -> None:
    toggle = cell("LUT1", {"I0": [6], "O": [5]})
    check(cm_harness_0_clock=toggle, cm_harness_0_3_ff=cell("FDRE", {"C": [5], "Q": [6]}))


def test_of_many_cells_three_are_named() -> None:
    with pytest.raises(BuildError, match=r"r0 .*r1 .*r2 .* and 5 more: "):
        check(**{f"r{at}": cell("FDSE", {"C": [5], "Q": [10 + at]}) for at in range(8)})

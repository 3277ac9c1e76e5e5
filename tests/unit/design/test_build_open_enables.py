# SPDX-License-Identifier: Apache-2.0
"""Which slices shift registers and memories in look-up tables may use: one write enable to each slice."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from cm.design.errors import BuildError
from cm.design.openflow.rewrites import shares
from cm.formats.xray import Tile

Cells = dict[str, dict[str, Any]]


def tiles(count: int) -> list[Tile]:
    """So many tiles whose left slice can be memory, and one without."""
    plain = Tile("CLBLL_L_X2Y0", "CLBLL_L", 2, 0, {}, ())
    return [*(Tile(f"CLBLM_R_X1Y{y}", "CLBLM_R", 1, y, {}, ()) for y in range(count)), plain]


def shift(enable: object) -> dict[str, Any]:
    return {"type": "SRL16E", "connections": {"CE": [enable], "CLK": [2], "D": [3], "Q": [4]}}


def memory(kind: str, enable: object, **more: list[object]) -> dict[str, Any]:
    return {"type": kind, "connections": {"WE": [enable], "WCLK": [2], **more}}


def shared(cells: Cells, count: int) -> tuple[dict[str, set[str]], dict[str, str]]:
    found = shares(cells, tiles(count), "module one")
    every = [place for places in found.areas.values() for place in places]
    assert len(every) == len(set(every))  # no slice belongs to two
    assert all(place.startswith("X1Y") for place in every)
    return {name: set(places) for name, places in found.areas.items()}, found.cells


def test_shift_registers_with_one_enable_may_be_anywhere() -> None:
    assert shared({"a": shift("1"), "b": shift("1")}, 1) == ({}, {})


def test_memories_alone_may_be_anywhere_as_no_two_of_them_share_a_slice() -> None:
    assert shared({"a": memory("RAM64M", 5), "b": memory("RAM32M", 6)}, 2) == ({}, {})


def test_each_enable_of_shift_registers_gets_slices_of_its_own_and_so_do_memories() -> None:
    cells: Cells = {f"s{number}": shift(5 + number % 2) for number in range(18)}
    cells |= {"m": memory("RAM128X1D", 5), "n": memory("RAM64M", 9)}
    areas, of = shared(cells, 24)
    assert Counter(of.values()) == {of["s0"]: 9, of["s1"]: 9, of["m"]: 2}
    # 3, 3 and 2 slices are needed, of 24
    assert {name: len(places) for name, places in areas.items()} == {of["s0"]: 9, of["s1"]: 9, of["m"]: 6}


def test_shift_registers_on_two_clocks_are_kept_apart_too() -> None:
    other = shift("1")
    other["connections"]["CLK"] = [7]
    areas, of = shared({"a": shift("1"), "b": other}, 2)
    assert of["a"] != of["b"]
    assert {len(places) for places in areas.values()} == {1}


@pytest.mark.parametrize(("pins", "slices"), [({"DPO": [8]}, 2), ({"DPO": [8], "SPO": [9]}, 3)])
def test_memories_with_two_ports_that_are_written_alike_share_slices(
    pins: dict[str, list[object]], slices: int
) -> None:
    cells: Cells = {f"m{number}": memory("RAM64X1D", 5, A0=[1], **pins) for number in range(5)}
    cells["s"] = shift("1")
    shared(cells, slices + 1)
    with pytest.raises(BuildError, match=f"take {slices + 1} slices"):
        shares(cells, tiles(slices), "module one")


def test_too_few_slices_for_that_are_told_with_what_to_change() -> None:
    cells: Cells = {"a": shift("1"), "b": shift(5), "m": memory("RAM32M", 6)}
    with pytest.raises(BuildError, match=r"module one: .* take 3 slices.* 2 can be memory .*the same enable"):
        shares(cells, tiles(2), "module one")

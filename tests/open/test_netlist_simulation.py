# SPDX-License-Identifier: Apache-2.0
"""A netlist cycle by cycle: registers and latches on both edges of a clock."""

from __future__ import annotations

from netlist_simulation import Simulation

from cm.simulation.bits import FlipFlop, Lut, Netlist


def store(data: str, output: str, *, inverted: bool = False, latch: bool = False) -> FlipFlop:
    return FlipFlop("clock:0", data, "1", "0", False, False, True, inverted, latch, output)


def outputs(cells: tuple[FlipFlop | Lut, ...], output: str, values: list[bool]) -> list[bool]:
    run, seen = Simulation(Netlist(cells, {"y": output})), []
    for value in values:
        run.set({"a": value})
        run.clock()
        seen.append(run.output("y"))
    return seen


VALUES = [True, False, False, True, True, False]


def test_a_register_on_the_falling_edge_takes_what_the_rising_one_has_left() -> None:
    cells = (store("port:a", "first"), store("first", "second", inverted=True))
    assert outputs(cells, "second", VALUES) == VALUES


def test_a_register_behind_one_on_the_falling_edge_is_a_cycle_behind() -> None:
    cells = (store("port:a", "first", inverted=True), store("first", "second"))
    assert outputs(cells, "second", VALUES) == [False, *VALUES[:-1]]


def test_a_latch_is_open_while_its_clock_is_high_and_keeps_what_it_saw() -> None:
    cells = (store("port:a", "first"), store("first", "second", latch=True))
    assert outputs(cells, "second", VALUES) == VALUES
    low = (store("port:a", "first"), store("first", "second", latch=True, inverted=True), store("second", "third"))
    assert outputs(low, "third", VALUES) == [False, *VALUES[:-1]]


def test_a_register_sees_a_latch_as_it_was_before_it_opened() -> None:
    cells = (store("port:a", "open", latch=True), store("open", "after"))
    assert outputs(cells, "after", VALUES) == [False, *VALUES[:-1]]

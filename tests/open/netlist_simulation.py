# SPDX-License-Identifier: Apache-2.0
"""Simulates a netlist cycle by cycle in Python, for short runs; Verilator is for long ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from cm.simulation.bits.cells import Carry, FlipFlop, Lut, LutMemory, Mux, Net, Netlist
from cm.simulation.bits.extract import needs, nets_of

ROUNDS = 50  # passes over all cells within which a loop without a register has to settle


@dataclass
class _Memory:
    cell: LutMemory
    state: int


@dataclass
class Simulation:
    """A running netlist. `unsettled` counts cycles in which a combinational loop did not settle."""

    netlist: Netlist
    values: dict[Net, bool] = field(default_factory=dict)
    unsettled: int = 0

    def __post_init__(self) -> None:
        cells = self.netlist.cells
        self._stores = [cell for cell in cells if isinstance(cell, FlipFlop)]
        self._memories = [_Memory(cell, cell.init) for cell in cells if isinstance(cell, LutMemory)]
        self._clocks = {net for cell in cells for net in needs(cell) if net.startswith("clock:")}
        self._order = _ordered(self.netlist)
        self.values |= {cell.output: cell.init for cell in self._stores}
        self.values |= {"0": False, "1": True}

    def set(self, ports: Mapping[str, bool]) -> None:
        """Give inputs new values (``NAME[BIT]``) and propagate them."""
        self.values |= {f"port:{name}": value for name, value in ports.items()}
        self._settle()

    def clock(self) -> None:
        """One cycle of all clocks: a rising edge with the present values, then a falling edge with the result."""
        for level in (True, False):
            self._settle()
            value = self._value
            stores = {cell.output: _next(cell, value) for cell in self._stores if cell.inverted != level}
            clocked = [memory for memory in self._memories if memory.cell.inverted != level]
            memories = [_written(memory, value) for memory in clocked]
            self.values |= stores
            for memory, state in zip(clocked, memories, strict=True):
                memory.state = state
            self.values |= dict.fromkeys(self._clocks, level)
        self._settle()

    def output(self, name: str) -> bool:
        """The value of an output."""
        return self._value(self.netlist.outputs[name])

    def _value(self, net: Net) -> bool:
        return self.values.get(net, False)

    def _settle(self) -> None:
        for _ in range(ROUNDS):
            before = dict(self.values)
            for evaluate in self._order:
                evaluate(self)
            for memory in self._memories:
                self._read(memory)
            for cell in self._stores:
                if not cell.synchronous and cell.reset != "0" and self._value(cell.reset):
                    self.values[cell.output] = cell.value
                elif cell.latch and self._value(cell.clock) != cell.inverted and self._value(cell.enable):
                    self.values[cell.output] = self._value(cell.data)
            if before == self.values:
                return
        self.unsettled += 1

    def _read(self, memory: _Memory) -> None:
        cell, state = memory.cell, memory.state
        address = sum(self._value(net) << bit for bit, net in enumerate(cell.inputs))
        if cell.shifts:
            address &= ~1
        self.values[cell.o6] = bool(state >> address & 1)
        self.values[cell.o5] = bool(state >> (address & 31) & 1)
        self.values[cell.last] = bool(state >> 63 & 1)


def _next(cell: FlipFlop, value: Callable[[Net], bool]) -> bool:
    if cell.latch or cell.clock in ("0", "1"):
        return value(cell.output)
    if value(cell.reset):
        return cell.value
    return value(cell.data) if value(cell.enable) else value(cell.output)


def _written(memory: _Memory, value: Callable[[Net], bool]) -> int:
    cell, state = memory.cell, memory.state
    if cell.clock in ("0", "1") or not all(value(net) == wanted for net, wanted in cell.enables):
        return state
    data, high = value(cell.data), value(cell.high_data)
    if cell.shifts:
        return _shifted(state, data, high, cell.small)
    address = sum(value(net) << bit for bit, net in enumerate(cell.write))
    if not cell.small:
        return _put(state, address, data)
    return _put(_put(state, address & 31, data), 32 + (address & 31), high)


def _put(state: int, bit: int, value: bool) -> int:
    return state | 1 << bit if value else state & ~(1 << bit)


def _shifted(state: int, data: bool, high: bool, small: bool) -> int:
    """Each entry of a shift register is two bits of the table."""
    if not small:
        return (state << 2 | 3 * data) & (1 << 64) - 1
    upper, lower = state >> 32, state & 0xFFFF_FFFF
    upper, lower = (upper << 2 | 3 * high) & 0xFFFF_FFFF, (lower << 2 | 3 * data) & 0xFFFF_FFFF
    return upper << 32 | lower


def _ordered(netlist: Netlist) -> list[Callable[[Simulation], None]]:
    """Evaluations, ordered so that inputs are computed first; loops in any order."""
    plain = [cell for cell in netlist.cells if isinstance(cell, (Lut, Mux, Carry))]
    maker = {net: index for index, cell in enumerate(plain) for net in nets_of(cell)}
    order: list[int] = []
    state = [0] * len(plain)
    for root in range(len(plain)):
        stack = [(root, False)]
        while stack:
            index, done = stack.pop()
            if done:
                order.append(index)
            elif not state[index]:
                state[index] = 1
                stack.append((index, True))
                stack += [(maker[net], False) for net in needs(plain[index]) if net in maker and not state[maker[net]]]
    return [_evaluation(plain[index]) for index in order]


def _evaluation(cell: Lut | Mux | Carry) -> Callable[[Simulation], None]:
    if isinstance(cell, Lut):
        return lambda run: _look_up(cell, run.values)
    if isinstance(cell, Mux):
        return lambda run: _choose(cell, run.values)
    return lambda run: _carry(cell, run.values)


def _look_up(cell: Lut, values: dict[Net, bool]) -> None:
    address = 0
    for bit, net in enumerate(cell.inputs):
        if values.get(net, False):
            address |= 1 << bit
    values[cell.output] = bool(cell.init >> address & 1)


def _choose(cell: Mux, values: dict[Net, bool]) -> None:
    values[cell.output] = values.get(cell.one if values.get(cell.select, False) else cell.zero, False)


def _carry(cell: Carry, values: dict[Net, bool]) -> None:
    carry = values.get(cell.begin, False)
    for select, data, total, out in zip(cell.select, cell.data, cell.sums, cell.carries, strict=True):
        chosen = values.get(select, False)
        values[total] = chosen != carry
        carry = carry if chosen else values.get(data, False)
        values[out] = carry

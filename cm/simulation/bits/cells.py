# SPDX-License-Identifier: Apache-2.0
"""The netlist that frames configure: cells of a slice (UG474), and nets by name.

A net is ``0``, ``1``, ``port:NAME[BIT]``, ``clock:N`` or an output of a cell (``CLBLM_R_X17Y87.SLICEM_X0.AO6``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from cm.frozen import dataclass

ZERO, ONE = "0", "1"
Net: TypeAlias = str


@dataclass(frozen=True, slots=True)
class Site:
    """What is configured in one place, such as ``CLBLM_R_X17Y87.SLICEM_X0`` or ``BRAM_L_X18Y80.RAMB18_Y0``.

    `features`: without the site's name. `pin` gives the net at an input.
    """

    name: str
    features: frozenset[str]
    pin: Callable[[str], Net]

    def output(self, pin: str) -> Net:
        """The net at an output: ``DOBDO7``, ``P7``."""
        return f"{self.name}.{pin}"


@dataclass(frozen=True, slots=True)
class Lut:
    """A function of the inputs that it depends on, at most six: `init` has a bit for each combination, the first
    input lowest."""

    init: int
    inputs: tuple[Net, ...]
    output: Net


@dataclass(frozen=True, slots=True)
class Mux:
    """F7AMUX, F7BMUX, F8MUX: `one` where `select` is 1."""

    zero: Net
    one: Net
    select: Net
    output: Net


@dataclass(frozen=True, slots=True)
class Carry:
    """CARRY4, lowest bit first: ``co[i] = s[i] ? ci : di[i]``, ``o[i] = s[i] ^ ci``."""

    begin: Net
    select: tuple[Net, ...]
    data: tuple[Net, ...]
    sums: tuple[Net, ...]
    carries: tuple[Net, ...]


@dataclass(frozen=True, slots=True)
class FlipFlop:
    """A storage element. `init` is what configuration leaves, `value` what `reset` sets; `latch`: open while its
    clock is high (low where `inverted`)."""

    clock: Net
    data: Net
    enable: Net
    reset: Net
    init: bool
    value: bool
    synchronous: bool
    inverted: bool
    latch: bool
    output: Net


@dataclass(frozen=True, slots=True)
class LutMemory:
    """A look-up table of a SLICEM that is written: memory (`shifts` False) or shift register.

    `small`: two of half the size, the lower one (O5) fed by `data`, the upper one by `high_data`. `write` are the
    address lines of the write port, A1 first; `enables` all have to be 1. `last`: MC31, what leaves a shift register.
    """

    init: int
    inputs: tuple[Net, ...]
    shifts: bool
    small: bool
    write: tuple[Net, ...]
    enables: tuple[tuple[Net, bool], ...]
    data: Net
    high_data: Net
    clock: Net
    inverted: bool
    o6: Net
    o5: Net
    last: Net


@dataclass(frozen=True, slots=True)
class BlockPort:
    """A port of a block RAM. Clock, enable and reset each with whether they count inverted; `data` and `lanes`, the
    write enables of bytes, are empty where nothing is written. `mode`: what is read while it writes."""

    clock: tuple[Net, bool]
    enable: tuple[Net, bool]
    reset: tuple[Net, bool]
    address: tuple[Net, ...]
    data: tuple[Net, ...]
    lanes: tuple[Net, ...]
    outputs: tuple[Net, ...]
    mode: str
    init: int
    value: int


@dataclass(frozen=True, slots=True)
class BlockMemory:
    """A RAMB18E1 whose ports have one width."""

    width: int
    words: tuple[int, ...]
    ports: tuple[BlockPort, ...]


@dataclass(frozen=True, slots=True)
class Dsp:
    """A DSP48E1: parameters and ports of ``dsp48.v``, the lowest bit of a port first, each with whether it counts
    inverted; `outputs` are P."""

    parameters: tuple[tuple[str, int], ...]
    pins: tuple[tuple[str, tuple[tuple[Net, bool], ...]], ...]
    outputs: tuple[Net, ...]


def reduced(init: int, inputs: Sequence[Net], output: Net) -> Lut:
    """The table without inputs that are constant or do not affect the result.

    Half a table often holds a function of its own, whose inputs stand at the other half's pins too.
    """
    left = list(inputs)
    for bit in reversed(range(len(left))):
        zero, one = _halves(init, bit, len(left))
        if left[bit] == ONE:
            init = one
        elif left[bit] == ZERO or zero == one:
            init = zero
        else:
            continue
        del left[bit]
    return Lut(init, tuple(left), output)


def _halves(init: int, bit: int, count: int) -> tuple[int, int]:
    """The tables for an input that is 0 and for one that is 1."""
    found = [0, 0]
    for value in (0, 1):
        for address in range(1 << count - 1):
            low = address & (1 << bit) - 1
            full = (address >> bit) << bit + 1 | value << bit | low
            found[value] |= (init >> full & 1) << address
    return found[0], found[1]


Cell: TypeAlias = Lut | Mux | Carry | FlipFlop | LutMemory | BlockMemory | Dsp


@dataclass(frozen=True, slots=True)
class Netlist:
    """Cells that outputs depend on, and the net of each output (``NAME[BIT]``).

    `notes`: things found on the way that a good design does not have.
    """

    cells: tuple[Cell, ...]
    outputs: Mapping[str, Net]
    notes: tuple[str, ...] = ()

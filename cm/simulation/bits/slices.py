# SPDX-License-Identifier: Apache-2.0
"""A slice's features as cells (UG474; names of features as Project X-Ray documents them)."""

from __future__ import annotations

from cm.simulation.bits.cells import ONE, ZERO, Carry, Cell, FlipFlop, Lut, LutMemory, Mux, Net, Site, reduced

LETTERS = "ABCD"
_INTO_F7 = {"A": ("B", "A", "AX"), "C": ("D", "C", "CX")}  # tables read at 0 and at 1, and what chooses


class Slice(Site):
    """A configured slice; names of nets begin with its name."""

    def output(self, pin: str) -> Net:
        """The net at an output pin: ``A``, ``AMUX``, ``AQ``, ``COUT``."""
        letter, kind = pin[0], pin[1:]
        if pin == "COUT":
            return self._inner("D", "CY")
        if not kind:
            return self._inner(letter, "O6")
        if kind == "Q":
            return self._inner(letter, "Q")
        chosen = self._choice(f"{letter}OUTMUX")
        return ZERO if chosen is None else self._inner(letter, "5Q" if chosen.endswith("5Q") else chosen)

    def making(self, inner: str) -> Cell:
        """The cell that makes an inner net, such as ``AO6``, ``BXOR`` or ``C5Q``."""
        letter, kind = inner[0], inner[1:]
        if kind in ("O6", "O5", "MC31"):
            return self._table(letter, kind)
        if kind in ("XOR", "CY"):
            return self._carry()
        if kind == "F7":
            zero, one, select = _INTO_F7[letter]
            return Mux(self._inner(zero, "O6"), self._inner(one, "O6"), self.pin(select), self._inner(letter, "F7"))
        if kind == "F8":
            return Mux(self._inner("C", "F7"), self._inner("A", "F7"), self.pin("BX"), self._inner("B", "F8"))
        if kind == "Q":
            return self._storage(letter, f"{letter}FF", self._data(letter), "Q", self._has("LATCH"))
        return self._storage(letter, f"{letter}5FF", self._data5(letter), "5Q", False)

    def _inner(self, letter: str, kind: str) -> Net:
        return f"{self.name}.{letter}{kind}"

    def _has(self, feature: str) -> bool:
        return feature in self.features

    def _choice(self, mux: str) -> str | None:
        """The input that a multiplexer is set to; None if it is set to none."""
        return next((one.removeprefix(f"{mux}.") for one in sorted(self.features) if one.startswith(f"{mux}.")), None)

    def _init(self, letter: str) -> int:
        return sum(1 << bit for bit in range(64) if self._has(f"{letter}LUT.INIT[{bit}]"))

    def _inputs(self, letter: str) -> tuple[Net, ...]:
        return tuple(self.pin(f"{letter}{number}") for number in range(1, 7))

    def _table(self, letter: str, kind: str) -> Lut | LutMemory:
        init, inputs = self._init(letter), self._inputs(letter)
        o6, o5 = self._inner(letter, "O6"), self._inner(letter, "O5")
        shifts = self._has(f"{letter}LUT.SRL")
        if not shifts and not self._has(f"{letter}LUT.RAM"):
            return reduced(init, inputs, o6) if kind == "O6" else reduced(init & 0xFFFF_FFFF, inputs[:5], o5)
        enables = [(self.pin("CE") if self._has("WEMUX.CE") else self.pin("WE"), True)]
        if self._has("WA7USED") and not shifts:  # as F7 reads them: B and D at 0
            enables.append((self.pin("CX"), letter in "AC"))
        if self._has("WA8USED") and not shifts:
            enables.append((self.pin("BX"), letter in "AB"))
        return LutMemory(
            init, inputs, shifts, self._has(f"{letter}LUT.SMALL"), self._inputs("D"), tuple(enables),
            self._written(letter), self.pin(f"{letter}X"), self.pin("CLK"), self._has("CLKINV"), o6, o5,
            self._inner(letter, "MC31"),
        )  # fmt: skip

    def _written(self, letter: str) -> Net:
        """DI1: a pin of its own, or what the table above it gets or shifts out."""
        if letter == "D" or self._has(f"{letter}LUT.DI1MUX.{letter}I"):
            return self.pin(f"{letter}I")
        above = LETTERS[LETTERS.index(letter) + 1]
        if self._has(f"{above}LUT.SRL"):
            return self._inner(above, "MC31")
        return self._written("D" if letter != "A" else above)

    def _carry(self) -> Carry:
        data = (
            self._inner(letter, "O5") if self._has(f"CARRY4.{letter}CY0") else self.pin(f"{letter}X")
            for letter in LETTERS
        )
        begin = {"AX": "AX", "CIN": "CIN"}.get(self._choice("PRECYINIT") or "")
        first = self.pin(begin) if begin else ONE if self._has("PRECYINIT.C1") else ZERO
        return Carry(
            first,
            tuple(self._inner(letter, "O6") for letter in LETTERS),
            tuple(data),
            tuple(self._inner(letter, "XOR") for letter in LETTERS),
            tuple(self._inner(letter, "CY") for letter in LETTERS),
        )

    def _data(self, letter: str) -> Net:
        chosen = self._choice(f"{letter}FFMUX")
        if chosen is None:
            return ZERO
        return self.pin(chosen) if chosen == f"{letter}X" else self._inner(letter, chosen)

    def _data5(self, letter: str) -> Net:
        return self.pin(f"{letter}X") if self._has(f"{letter}5FFMUX.IN_B") else self._inner(letter, "O5")

    def _storage(self, letter: str, element: str, data: Net, output: str, latch: bool) -> FlipFlop:
        return FlipFlop(
            clock=self.pin("CLK"),
            data=data,
            enable=self.pin("CE") if self._has("CEUSEDMUX") else ONE,
            reset=self.pin("SR") if self._has("SRUSEDMUX") else ZERO,
            init=not self._has(f"{element}.ZINI"),
            value=not self._has(f"{element}.ZRST"),
            synchronous=self._has("FFSYNC"),
            inverted=self._has("CLKINV"),
            latch=latch,
            output=self._inner(letter, output),
        )

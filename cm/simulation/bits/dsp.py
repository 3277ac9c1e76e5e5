# SPDX-License-Identifier: Apache-2.0
"""DSP48E1 by its features (UG479): multiplier, pre-adder and adder; not cascades, logic functions, SIMD, patterns."""

from __future__ import annotations

from collections.abc import Mapping

from cm.simulation.bits.cells import ONE, ZERO, Dsp, Net, Site

OUTPUTS = tuple(f"P{bit}" for bit in range(48))
_BUSES = {"A": 30, "B": 18, "C": 48, "D": 25, "INMODE": 5, "OPMODE": 7, "ALUMODE": 4}
_WIRES = (
    *("CLK", "CARRYIN", "CEA1", "CEA2", "CEB1", "CEB2", "CEC", "CED", "CEAD", "CEM", "CEP", "CEINMODE", "CECTRL"),
    *("CEALUMODE", "CECARRYIN", "RSTA", "RSTB", "RSTC", "RSTD", "RSTM", "RSTP", "RSTINMODE", "RSTCTRL"),
    *("RSTALUMODE", "RSTALLCARRYIN"),
)
_INVERTIBLE = ("INMODE", "OPMODE", "ALUMODE", "CLK", "CARRYIN")  # inverted unless a feature says otherwise
_SINGLE = ("CREG", "DREG", "ADREG", "MREG", "PREG", "INMODEREG", "OPMODEREG", "ALUMODEREG", "CARRYINREG")
_CASCADES, _PRODUCT = (1, 5), ("A_INPUT", "B_INPUT", "USE_SIMD")


class Slice48(Site):
    """One of the two of a tile."""

    def why_not(self, pin: str) -> str:
        """Which of its features are not simulated for an output; empty if all are."""
        if pin not in OUTPUTS:
            return f"drives logic with {pin}"
        strange = [one for one in sorted(self.features) if one.startswith(_PRODUCT)]
        if strange:
            return f"has {strange[0]}"
        if any(self.pin(f"CARRYINSEL{bit}") != ZERO for bit in range(3)):
            return "takes its carry from elsewhere than CARRYIN"
        alu, op = (self._constant(bus, low) for bus, low in (("ALUMODE", 2), ("OPMODE", 4)))
        if alu:
            return "computes a logic function"
        return "takes the cascade of another" if op in _CASCADES else ""

    def cell(self) -> Dsp:
        """The cell."""
        registers = {f"{name}REG": self._depth(name) for name in "AB"}
        registers |= {name: 1 - (f"Z{name}[0]" in self.features) for name in _SINGLE}
        registers["DPORT"] = int("USE_DPORT[0]" in self.features)
        return Dsp(tuple(registers.items()), tuple(self._pins().items()), tuple(map(self.output, OUTPUTS)))

    def _depth(self, name: str) -> int:
        return 0 if f"{name}REG_0" in self.features else 2 if f"{name}REG_2" in self.features else 1

    def _pins(self) -> Mapping[str, tuple[tuple[Net, bool], ...]]:
        """By port, the lowest bit first: the nets, and whether each counts inverted."""
        buses = {name: tuple(self._input(name, bit) for bit in range(width)) for name, width in _BUSES.items()}
        return buses | {name: (self._input(name, None),) for name in _WIRES}

    def _input(self, name: str, bit: int | None) -> tuple[Net, bool]:
        index = "" if bit is None else f"[{bit}]"
        inverted = name in _INVERTIBLE and f"ZIS_{name}_INVERTED{index}" not in self.features
        return self.pin(name if bit is None else f"{name}{bit}"), inverted

    def _constant(self, bus: str, low: int) -> int | None:
        """The value of a bus from a bit on; None where it is not a constant."""
        value = 0
        for bit in range(low, _BUSES[bus]):
            net, inverted = self._input(bus, bit)
            if net not in (ZERO, ONE):
                return None
            value |= ((net == ONE) != inverted) << bit - low
        return value

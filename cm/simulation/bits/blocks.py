# SPDX-License-Identifier: Apache-2.0
"""Block RAM by its features (UG473): halves of a tile that work as RAMB18E1, with one width for all that is used."""

from __future__ import annotations

import re

from cm.simulation.bits.cells import BlockMemory, BlockPort, Net, Site

HALVES = {"BRAM_FIFO18_": 0, "BRAM_RAMB18_": 1}  # wires of a tile that begin so are of its lower, its upper half
_NAMES = {  # of ports: address, clock, enable, reset, data in and out with parity, write enables
    "A": ("ADDRARDADDR", "CLKARDCLK", "ENARDEN", "RSTRAMARSTRAM", "DIADI", "DIPADIP", "DOADO", "DOPADOP", "WEA"),
    "B": ("ADDRBWRADDR", "CLKBWRCLK", "ENBWREN", "RSTRAMB", "DIBDI", "DIPBDIP", "DOBDO", "DOPBDOP", "WEBWE"),
}
_WIDTHS = {1: 0, 2: 1, 4: 2, 9: 3, 18: 4}  # bits of a word, and of an address that choose within the widest
_CONTENTS = re.compile(r"INIT(P?)_([0-9A-F]{2})\[(\d+)\]")
_DEPTH = 14  # bits of an address


class Half(Site):
    """Half a tile."""

    def why_not(self) -> str:
        """Which of its features are not simulated; empty if all are."""
        if "IN_USE" not in self.features:
            return "is not in use"
        if len(self._used()) != 1:
            return f"has ports of different widths ({', '.join(map(str, sorted(self._used())))})"
        strange = [
            one for one in sorted(self.features) if one.startswith(("DOA_REG", "DOB_REG", "RAM_MODE", "FIFO", "SDP"))
        ]
        return f"has {strange[0]}" if strange else ""

    def memory(self) -> BlockMemory:
        """The cell."""
        (width,) = self._used()
        words = [0] * (1 << _DEPTH - _WIDTHS[width])
        for feature in self.features:
            found = _CONTENTS.fullmatch(feature)
            if found is not None:
                self._put(words, width, bool(found[1]), int(found[2], 16) * 256 + int(found[3]))
        return BlockMemory(width, tuple(words), tuple(self._port(name, width) for name in "AB"))

    def _used(self) -> set[int]:
        found = (re.fullmatch(r"(?:READ|WRITE)_WIDTH_[AB]_(\d+)", feature) for feature in self.features)
        return {int(one[1]) for one in found if one is not None} or {1}

    @staticmethod
    def _put(words: list[int], width: int, parity: bool, bit: int) -> None:
        data = width - width // 9  # bits of a word without its parity
        if parity:
            words[bit // (width // 9)] |= 1 << data + bit % (width // 9)
        else:
            words[bit // data] |= 1 << bit % data

    def _input(self, pin: str) -> tuple[Net, bool]:
        """The net, and whether it is inverted: inputs that can be inverted are, unless a feature says otherwise."""
        return self.pin(pin), f"ZINV_{pin}" not in self.features

    def _port(self, letter: str, width: int) -> BlockPort:
        address, clock, enable, reset, din, dinp, dout, doutp, write = _NAMES[letter]
        data, parity, within = width - width // 9, width // 9, _WIDTHS[width]
        ins = [*(f"{din}{bit}" for bit in range(data)), *(f"{dinp}{bit}" for bit in range(parity))]
        outs = [*(f"{dout}{bit}" for bit in range(data)), *(f"{doutp}{bit}" for bit in range(parity))]
        writes = any(feature.startswith(f"WRITE_WIDTH_{letter}_") for feature in self.features)
        mode = next(
            (m for m in ("READ_FIRST", "NO_CHANGE") if f"WRITE_MODE_{letter}_{m}" in self.features), "WRITE_FIRST"
        )
        return BlockPort(
            clock=self._input(clock),
            enable=self._input(enable),
            reset=self._input(reset),
            address=tuple(self.pin(f"{address}{bit}") for bit in range(within, _DEPTH)),
            data=tuple(self.pin(pin) for pin in ins) if writes else (),
            # two pins stand for each byte of the word
            lanes=tuple(self.pin(f"{write}{2 * lane}") for lane in range(max(1, parity))) if writes else (),
            outputs=tuple(self.output(pin) for pin in outs),
            mode=mode,
            init=self._missing(f"ZINIT_{letter}", width),
            value=self._missing(f"ZSRVAL_{letter}", width),
        )

    def _missing(self, name: str, width: int) -> int:
        return sum(1 << bit for bit in range(width) if f"{name}[{bit}]" not in self.features)

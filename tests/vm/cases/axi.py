# SPDX-License-Identifier: Apache-2.0
"""The modelled engines under the kernel's own drivers: what they saw, and what a test lets happen to them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from served import until

ROOT = Path("/sys/kernel/debug/cm_axi")
S2MM = 0x30  # of its registers
DMASR = 0x04
HALTED, SLAVE_ERROR = 1 << 0, 1 << 5


class Access(NamedTuple):
    """One line of an engine's trace: r(ead), w(rite), i(nterrupt), d(one)."""

    what: str
    offset: int
    value: int


@dataclass(frozen=True)
class Engine:
    """One engine by its label in dts/overlays/qemu-virt/silicon.dtso."""

    label: str

    @property
    def _folder(self) -> Path:
        return ROOT / self.label

    def state(self, name: str) -> int:
        """A counter or register: `s2mm_transfers`, `mm2s_sr`, …"""
        lines = (self._folder / "state").read_text().splitlines()
        return int(dict(line.split(": ") for line in lines)[name])

    def number(self, name: str) -> int:
        """A number in a file of its own: loads, words."""
        return int((self._folder / name).read_text(), 0)

    def set(self, name: str, value: int) -> None:
        (self._folder / name).write_text(str(value))

    def trace(self) -> list[Access]:
        """What happened since the last `clear`."""
        lines = (self._folder / "trace").read_text().splitlines()
        return [Access(what, int(offset, 16), int(value, 16)) for what, offset, value in map(str.split, lines)]

    def clear(self) -> None:
        (self._folder / "trace").write_text("0")

    def give(self, data: bytes) -> None:
        """A packet arrives at S2MM."""
        (self._folder / "packet").write_bytes(data)

    def sent(self, size: int = 1 << 20) -> bytes:
        """The oldest packet that MM2S has sent, b"" where there is none."""
        with (self._folder / "packet").open("rb", buffering=0) as file:
            return file.read(size)

    def inject(self, channel: str, error: int) -> None:
        """The channel's next transfer ends with bits of DMASR."""
        (self._folder / channel / "inject").write_text(str(error))

    def until(self, name: str, value: int) -> None:
        until(lambda: self.state(name) == value)

    @contextlib.contextmanager
    def held(self, channel: str) -> Iterator[None]:
        """Nothing moves meanwhile: the stream is not ready."""
        hold = self._folder / channel / "hold"
        hold.write_text("1")
        try:
            yield
        finally:
            hold.write_text("0")
            (self._folder / "kick").write_text("1")

    @contextlib.contextmanager
    def stuck(self, channel: str) -> Iterator[None]:
        """RS = 0 does not halt the channel: its driver waits its whole second."""
        sticks = self._folder / channel / "sticks"
        sticks.write_text("1")
        try:
            yield
        finally:
            sticks.write_text("0")

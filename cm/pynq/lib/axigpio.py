# SPDX-License-Identifier: Apache-2.0
"""`AxiGPIO`: the wires of an AXI GPIO, by channel, index and slice (PG144)."""

from __future__ import annotations

import asyncio
from functools import partialmethod

from cm.pynq.board import Interrupt
from cm.pynq.overlay import DefaultIP, Description

_ENABLE, _GLOBAL = 0x128, 0x11C


class Wires:
    """Wires `start` to `stop` - 1 of a channel. The lowest is bit 0 of a value."""

    def __init__(self, channel: Channel, start: int, stop: int) -> None:
        if not 0 <= start < stop <= channel.length:
            raise IndexError(f"no wires {start} to {stop - 1} in a channel of {channel.length}")
        self._channel, self._start, self._mask = channel, start, (1 << (stop - start)) - 1

    def read(self) -> int:
        """Their value. Wires of both directions become inputs."""
        self._channel.turn(self._mask << self._start, inputs=True)
        return self._channel.read() >> self._start & self._mask

    def write(self, val: int) -> None:
        """Write them; those of both directions become outputs. Raises ValueError before anything is changed."""
        if not 0 <= val <= self._mask:
            raise ValueError(f"{val} too large for {self._mask.bit_length()} bits")
        self._channel.turn(self._mask << self._start, inputs=False)
        self._channel.write(val << self._start, self._mask << self._start)

    def on(self) -> None:
        """Write ones; `off` writes zeros."""
        self.write(self._mask)

    off = partialmethod(write, 0)

    def toggle(self) -> None:
        """Write the opposite of what was written last."""
        self.write(~self._channel.written >> self._start & self._mask)

    async def wait_for_value_async(self, value: int) -> None:
        """Until they have a value; needs the block's interrupt."""
        while self.read() != value:
            await self._channel.wait_for_interrupt_async()

    def wait_for_value(self, value: int) -> None:
        """As `wait_for_value_async`, outside of tasks."""
        asyncio.run(self.wait_for_value_async(value))


class Channel:
    """Up to 32 wires: ``channel[3].on()``, ``channel[0:4].write(9)``."""

    def __init__(self, parent: AxiGPIO, number: int) -> None:
        self._parent, self._number = parent, number
        self.direction, self.length, self.written = "inout", 32, 0

    def __getitem__(self, wires: int | slice) -> Wires:
        if not isinstance(wires, slice):
            return Wires(self, wires, wires + 1)
        if wires.step not in (None, 1):
            raise IndexError("Steps other than 1 not supported")
        return Wires(self, wires.start or 0, self.length if wires.stop is None else wires.stop)

    def read(self) -> int:
        """All wires; of outputs what was written last."""
        return self.written if self.direction == "out" else self._parent.read(8 * self._number)

    def write(self, val: int, mask: int) -> None:
        """Write the wires in `mask`. Raises RuntimeError of inputs."""
        if self.direction == "in":
            raise RuntimeError("You cannot write to an Input")
        self.written = (self.written & ~mask) | (val & mask)
        self._parent.write(8 * self._number, self.written)

    def turn(self, mask: int, inputs: bool) -> None:
        """Make the wires in `mask` inputs or outputs, in a channel of both directions."""
        if self.direction == "inout":
            self._parent.mmio.write_masked(8 * self._number + 4, mask * inputs, mask)

    def setlength(self, length: int) -> None:
        """Set the number of wires."""
        self.length = length

    def setdirection(self, direction: str) -> None:
        """``"in"``, ``"out"`` or ``"inout"``, or AxiGPIO.Input and so on. The block's own direction is not written."""
        if direction not in ("in", "out", "inout"):
            raise ValueError("direction should be one of AxiGPIO.{Input,Output,InOut}, or 'in', 'out' or 'inout'")
        self.direction = direction

    async def wait_for_interrupt_async(self) -> None:
        """Until a wire has changed; the manager acknowledges it."""
        pins, mask = self._parent.description["interrupts"], 1 << self._number
        if "ip2intc_irpt" not in pins:
            raise RuntimeError("Interrupts not available for this IP")
        self._parent.write(_GLOBAL, 1 << 31)
        self._parent.mmio.write_masked(_ENABLE, mask, mask)
        await Interrupt(pins["ip2intc_irpt"]["fullpath"] + ("_2" if self._number else "")).wait()  # by its status bit


class AxiGPIO(DefaultIP):
    """An AXI GPIO with `channel1` and `channel2`; an index takes wires of the first."""

    bindto = ("xilinx.com:ip:axi_gpio:2.0",)
    Input, Output, InOut = "in", "out", "inout"

    def __init__(self, description: Description) -> None:
        super().__init__(description)
        self.channel1, self.channel2 = self._channels = (Channel(self, 0), Channel(self, 1))

    def setlength(self, length: int, channel: int = 1) -> None:
        """Set the number of wires of channel 1 or 2."""
        self._channels[channel - 1].setlength(length)

    def setdirection(self, direction: str, channel: int = 1) -> None:
        """As of the channel 1 or 2."""
        self._channels[channel - 1].setdirection(direction)

    def __getitem__(self, wires: int | slice) -> Wires:
        return self.channel1[wires]

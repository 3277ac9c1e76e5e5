# SPDX-License-Identifier: Apache-2.0
"""What common blocks do, by VLNV: AXI GPIO (PG144), AXI Timer (PG079), AXI UART Lite (PG142), AXI DMA (PG021), HLS.

A model of one's own is a `Model` under its VLNV in ``MODELS``, with or without the version.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

from cm.schema.model import Block
from cm.simulation.software.errors import NodeError, SimError
from cm.simulation.software.hardware.models import Model

# Their streams leave as they came, at least as bytes; their registers, if any, are left to what they are.
_PASSING = ["axis_data_fifo", "axis_register_slice", "axis_clock_converter", "axis_dwidth_converter", "fifo_generator"]
# Kernel drivers have their registers, or nothing can be seen of them from here.
_OTHERS = ["axi_vdma", "axi_mcdma", "axi_cdma", "axi_intc", "axi_bram_ctrl", "dfx_decoupler", "pr_decoupler"]


def expected(block: Block) -> bool:
    """Whether somebody may wonder that nothing models a block."""
    return block.vlnv.split(":")[2:3] not in [[name] for name in _OTHERS]


class Passes(Model):
    """What comes in leaves."""


class AxiGpio(Model):
    """Outputs read as they were written, inputs 0; the status of interrupts is toggled by ones."""

    def wrote(self, offset: int, value: int, before: int) -> None:
        """A write to IP_ISR."""
        if offset == 0x120:
            self.words[0x120 // 4] = before ^ value


class AxiTimer(Model):
    """Both timers at 100 MHz: load, up and down, auto reload, interrupt."""

    RATE = 100e6
    reads = (0x08, 0x18)

    def start(self) -> None:
        """Both stand."""
        self._began: dict[int, tuple[float, int]] = {}  # by timer: when, and at which count

    def wrote(self, offset: int, value: int, before: int) -> None:
        """A write to a timer's TCSR; 1 clears its interrupt."""
        timer = offset & ~0xF
        if offset & 0xF or timer > 0x10:
            return
        self.words[timer // 4] = value & ~0x100 | before & ~value & 0x100
        if value & 0x20:
            self.words[timer // 4 + 2] = self.words[timer // 4 + 1]
        if value & 0x80 and timer not in self._began:
            self._run(timer, int(self.words[timer // 4 + 2]))
        elif not value & 0x80 and timer in self._began:
            self.words[timer // 4 + 2] = self.read(timer + 8)
            del self._began[timer]

    def read(self, offset: int) -> int:
        """A counter as it is now."""
        timer = offset & ~0xF
        if timer not in self._began:
            return int(self.words[offset // 4])
        since, count = self._began[timer]
        ticks = int((time.monotonic() - since) * self.RATE)
        down = int(self.words[timer // 4]) & 2
        return (count - ticks if down else count + ticks) & 0xFFFFFFFF

    def _run(self, timer: int, count: int) -> None:
        self._began[timer] = began = time.monotonic(), count
        ticks = count if int(self.words[timer // 4]) & 2 else 0xFFFFFFFF - count
        self.board.after(max(ticks / self.RATE, 1e-6), lambda: self._over(timer, began))

    def _over(self, timer: int, began: tuple[float, int]) -> None:
        if self._began.get(timer) != began:
            return
        control = int(self.words[timer // 4])
        self.words[timer // 4] = control | 0x100
        if control & 0x40 and self.interrupts:
            self.board.interrupt(self.interrupts[min(timer // 16, len(self.interrupts) - 1)])
        if control & 0x10:
            self._run(timer, int(self.words[timer // 4 + 1]))
        else:
            del self._began[timer]
            self.words[timer // 4 + 2] = 0 if control & 2 else 0xFFFFFFFF


class AxiDma(Model):
    """Simple mode by the registers, for a design whose schema describes them; no interrupts.

    Its channels are those of the driver: they move what registers begin as they move what the driver does.
    """

    _ENGINES = {0x00: "mm2s", 0x30: "s2mm"}  # noqa: RUF012 (never changed)
    _HALTED, _IDLE, _INTERNAL, _DECODE, _DONE, _CLEARED = 1, 2, 0x10, 0x40, 0x1000, 0x7000

    def start(self) -> None:
        """Both directions are halted."""
        self._cancels: dict[int, Callable[[], None]] = {}  # by engine, of what is under way
        self._open = len(self.words) >= 24
        if self._open:
            self._reset()

    def stop(self) -> None:
        """Nothing is under way any more."""
        cancels, self._cancels = self._cancels, {}
        for cancel in cancels.values():
            cancel()

    def wrote(self, offset: int, value: int, before: int) -> None:
        """A write to a control, status or length register; addresses are kept."""
        base, register = offset // 0x30 * 0x30, offset % 0x30
        if not self._open or self._ENGINES.get(base) not in self.channels:
            return
        if register == 0x00 and value & 4:
            self.stop()
            self._reset()
        elif register == 0x00:
            self._set(base, 0, self._HALTED) if value & 1 else self._set(base, self._HALTED, 0)
        elif register == 0x04:
            self.words[offset // 4] = before & ~(value & self._CLEARED)
        elif register == 0x28 and not int(self.words[base // 4 + 1]) & self._HALTED and base not in self._cancels:
            self._begin(base, value)

    def _begin(self, base: int, length: int) -> None:
        low, high = (int(word) for word in self.words[base // 4 + 6 : base // 4 + 8])
        self._set(base, 0, self._IDLE)
        try:
            self._cancels[base] = self.board.transfer(
                self.channels[self._ENGINES[base]], high << 32 | low, length, partial(self._ended, base)
            )
        except SimError:  # no memory is there
            self._set(base, self._HALTED | self._DECODE, 0)
        except NodeError:  # nothing to move, or the driver's transfer is under way
            self._set(base, self._HALTED | self._INTERNAL, 0)

    def _ended(self, base: int, moved: int, status: int) -> None:
        if self._cancels.pop(base, None) is not None:
            self.words[base // 4 + 10] = moved
            self._set(base, self._HALTED | self._INTERNAL if status else self._IDLE | self._DONE, 0)

    def _set(self, base: int, ones: int, zeros: int) -> None:
        at = base // 4 + 1
        self.words[at] = int(self.words[at]) & ~zeros | ones

    def _reset(self) -> None:
        for base in self._ENGINES:
            self.words[base // 4 : base // 4 + 11] = [0x10002, 0x10001, *[0] * 9]


class UartLite(Model):
    """What is sent is printed, by lines; nothing is received."""

    def start(self) -> None:
        """Nothing was sent."""
        self._line = bytearray()
        if len(self.words) > 2:
            self.words[2] = 4  # the transmitter is empty

    def wrote(self, offset: int, value: int, before: int) -> None:  # noqa: ARG002 - a model's signature
        """A write to the transmitter."""
        if offset == 4:
            self._line.append(value & 0xFF)
            if self._line.endswith(b"\n"):
                print(f"{self.name}: {self._line[:-1].decode('ascii', 'replace')}")
                self._line.clear()


class HlsKernel(Model):
    """The handshake of a kernel (UG1399, S_AXILITE control): `work` is done as soon as it is started.

    A subclass says what the kernel does: in `work`, for arguments in registers and memory, or in `frame`.
    """

    reads = (0,)

    def start(self) -> None:
        """It is idle."""
        self.words[0] = 4

    def work(self) -> None:
        """What the kernel does; arguments are in `registers`."""

    def wrote(self, offset: int, value: int, before: int) -> None:
        """A write to the control register, or ones that toggle the status of interrupts."""
        if offset == 0xC:
            self.words[3] = before ^ value
        elif offset == 0:
            self.words[0] = before & ~0x81 | value & 0x81
            if value & 1:
                self.words[0] &= 0xFFFFFFFB
                self.board.after(0, self._done)

    def read(self, offset: int) -> int:
        """The control register; what was done is told once."""
        value = int(self.words[offset // 4])
        self.words[offset // 4] = value & ~0xA
        return value

    def _done(self) -> None:
        self.work()
        again = int(self.words[0]) & 0x80
        self.words[0] = 0xA | again | (1 if again else 4)
        wanted = int(self.words[2]) & 3 if len(self.words) > 3 and int(self.words[1]) & 1 else 0
        for bit, name in zip((1, 2), self.interrupts, strict=False):
            if wanted & bit:
                self.board.interrupt(name)
        if again:
            self.board.after(0.001, self._done)


STANDARD: Mapping[str, type[Model]] = MappingProxyType(
    {
        **{f"xilinx.com:ip:{name}": Passes for name in _PASSING},
        "xilinx.com:ip:axi_dma": AxiDma,
        "xilinx.com:ip:axi_gpio": AxiGpio,
        "xilinx.com:ip:axi_timer": AxiTimer,
        "xilinx.com:ip:axi_uartlite": UartLite,
    }
)

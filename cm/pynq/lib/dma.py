# SPDX-License-Identifier: Apache-2.0
"""`DMA`: `transfer` and `wait` over the streams of an AXI DMA, whose registers the kernel's driver keeps."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from operator import index
from typing import Any

from cm.client.aio.waiting import Waits
from cm.client.errors import ConnectionLost
from cm.client.places import WHOLE
from cm.client.writer import Transfers
from cm.errors import CmError, Timeout
from cm.pynq.board import PynqBuffer, board, buffer_at
from cm.pynq.mmio import MMIO
from cm.pynq.overlay import DefaultIP, Description


class _Channel:
    """One direction. The engine reads and writes the buffers themselves."""

    def __init__(self, stream: str) -> None:
        self._stream, self._failed = stream, ""
        self._begun: Transfers | None = None
        self.running, self.address = True, 0  # the latter of a transfer's first byte, for the device

    @property
    def idle(self) -> bool:
        """Whether no transfer is under way; False before the first, as the hardware's bit."""
        return self._begun is not None and self._ended(0)

    @property
    def error(self) -> bool:
        """Whether the last transfer failed; `wait` says why."""
        return self.idle and bool(self._failed)

    @property
    def transferred(self) -> int:
        """Bytes of the last transfer, once it has ended."""
        return self._begun.moved if self.idle and self._begun is not None else 0

    def start(self) -> None:
        """Let transfers begin, after `stop`."""
        self.running, self._failed = True, ""

    def stop(self) -> None:
        """Give the stream back, until `start`; a transfer under way is given up."""
        begun, self._begun, self.running = self._begun, None, False
        if begun is not None:
            begun.close()

    def transfer(self, array: PynqBuffer, start: int = 0, nbytes: int = 0, cyclic: bool = False) -> None:
        """Begin to transfer `nbytes` (0: the rest) of a buffer of `allocate`, from byte `start` on.

        Raises RuntimeError while another is under way, ValueError for bytes that are not the buffer's.
        """
        if cyclic:
            raise NotImplementedError("transfer(cyclic=True): cm.connect().configure_stream(name, cyclic=True) has it")
        if not self.running or not self._ended(0):
            raise RuntimeError(f"DMA channel not {'idle' if self.running else 'started'}")
        self._begun = self._begun or board().transfers(self._stream)
        self._begun.begin(array, start, nbytes)
        self.address, self._failed = array.physical_address + start, ""

    def wait(self) -> None:
        """Until the transfer has ended. Raises RuntimeError with the reason if it failed."""
        if self._begun is None and not self._failed:
            raise RuntimeError("no transfer was begun" if self.running else "DMA channel not started")
        self._ended(None)
        if self._failed:
            raise RuntimeError(self._failed)

    async def wait_async(self) -> None:
        """As `wait`, while other tasks run."""
        while (begun := self._begun) is not None and not self._ended(0):
            await Waits().readable(begun.fileno(), None)
        self.wait()

    def _ended(self, seconds: float | None) -> bool:
        """Whether nothing is under way any more, after so many seconds at most."""
        try:
            if self._begun is not None:
                self._begun.flush(seconds)
        except Timeout:
            return False
        except CmError as error:
            self._failed = str(error)
            if isinstance(error, ConnectionLost):  # the next transfer asks for the stream again
                self._begun = None
        return True


_channel = cache(_Channel)  # a stream is one client's alone: the overlays of a program have its channel in common


class _Engine(MMIO):
    """The registers of the engine without scatter/gather (PG021), by the transfers; the driver has the real ones."""

    channels: Mapping[int, _Channel | None]

    def read(self, offset: int = 0, length: int = 4) -> int:  # noqa: ARG002 - a window's signature
        """Control (run), status (halted, idle, error, done), address and length of a channel; 0 for the rest."""
        channel = self.channels.get(offset // 0x30 * 0x30)
        if channel is None:
            return 0
        status = int(not channel.running) | channel.idle * 0x1002 | channel.error << 4
        known = {0x00: int(channel.running), 0x04: status, 0x18: channel.address & WHOLE, 0x1C: channel.address >> 32}
        return {**known, 0x28: channel.transferred}.get(offset % 0x30, 0)

    def write(self, offset: int, data: Any) -> None:
        """Control (run or reset), address, and length, which begins the transfer of a buffer of `allocate`.

        Raises NotImplementedError for others but status, NotFound for an address in no buffer, and as `transfer`.
        """
        channel, at, value = self.channels.get(offset // 0x30 * 0x30), offset % 0x30, index(data)
        if channel is None or at not in (0x00, 0x04, 0x18, 0x1C, 0x28):
            raise NotImplementedError(f"a DMA's other registers are the driver's ({offset:#x} = {data})")
        if at == 0x00:
            (channel.start if value & 5 == 1 else channel.stop)()
        elif at == 0x18:
            channel.address = channel.address >> 32 << 32 | value
        elif at == 0x1C:
            channel.address = channel.address & WHOLE | value << 32
        elif at == 0x28:
            channel.transfer(*buffer_at(channel.address), value or -1)  # 0 is no length in hardware

    def write_masked(self, offset: int, value: int, mask: int) -> None:
        """Write only the bits in `mask`."""
        self.write(offset, self.read(offset) & ~mask | value)


class DMA(DefaultIP):
    """An AXI DMA: `sendchannel` and `recvchannel`; one that the design has not is None."""

    bindto = ("xilinx.com:ip:axi_dma:7.1",)

    def __init__(self, description: Description) -> None:
        super().__init__(description)
        there = {way: _channel(stream) for way, stream in description["channels"].items()}
        self.sendchannel, self.recvchannel = there.get("mm2s"), there.get("s2mm")
        self.mmio = _Engine(description["phys_addr"], description["addr_range"])
        self.mmio.channels = {0x00: self.sendchannel, 0x30: self.recvchannel}
        for channel in there.values():
            channel.start()

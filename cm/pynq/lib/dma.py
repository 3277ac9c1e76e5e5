# SPDX-License-Identifier: Apache-2.0
"""`DMA`: `transfer` and `wait` over the streams of an AXI DMA, whose registers the kernel's driver keeps."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from cm.client.errors import ConnectionLost
from cm.client.writer import Transfers
from cm.errors import CmError, Timeout
from cm.pynq.board import board, opened
from cm.pynq.buffer import PynqBuffer
from cm.pynq.mmio import MMIO
from cm.pynq.overlay import DefaultIP, Description


class _Channel:
    """One direction. The engine reads and writes the buffers themselves."""

    def __init__(self, stream: str) -> None:
        self._stream = stream
        self._failed = ""
        self.running = True
        self.address = 0  # of the last transfer's first byte, for the device

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
        begun = self._begun
        return begun.moved if begun is not None and self.idle else 0

    def start(self) -> None:
        """Let transfers begin, after `stop`."""
        self.running, self._failed = True, ""

    def stop(self) -> None:
        """Give the stream back, until `start`; a transfer under way is given up."""
        begun, self.running = opened().pop(self._stream, None), False
        if begun is not None:
            begun.close()

    def transfer(self, array: PynqBuffer, start: int = 0, nbytes: int = 0, cyclic: bool = False) -> None:
        """Begin to transfer `nbytes` (0: the rest) of a buffer of `allocate`, from byte `start` on.

        Raises RuntimeError while another is under way, ValueError for bytes that are not the buffer's.
        """
        if cyclic:
            raise NotImplementedError("transfer(cyclic=True): cm.connect().configure_stream(name, cyclic=True) has it")
        if not isinstance(array, PynqBuffer):
            raise TypeError(f"a DMA transfers buffers of allocate(), not {type(array).__name__}")
        if not self.running or not self._ended(0):
            raise RuntimeError(f"DMA channel not {'idle' if self.running else 'started'}")
        begun = self._begun
        if begun is None:
            begun = opened()[self._stream] = board().transfers(self._stream)
        begun.begin(array, start, nbytes)
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
        loop, came = asyncio.get_running_loop(), asyncio.Event()
        while (begun := self._begun) is not None and not self._ended(0):
            loop.add_reader(begun.fileno(), came.set)
            await came.wait()
            loop.remove_reader(begun.fileno())
            came.clear()
        self.wait()

    @property
    def _begun(self) -> Transfers | None:
        return opened().get(self._stream)

    def _ended(self, seconds: float | None) -> bool:
        """Whether nothing is under way any more, after so many seconds at most."""
        begun = self._begun
        try:
            if begun is not None:
                begun.flush(seconds)
        except Timeout:
            return False
        except ConnectionLost as error:
            opened().pop(self._stream, None)
            self._failed = str(error)
        except CmError as error:
            self._failed = str(error)
        return True


class _Engine(MMIO):
    """What the registers of the engine read as (PG021), by the transfers; the driver has the real ones."""

    channels: Mapping[int, _Channel | None]

    def read(self, offset: int = 0, length: int = 4, word_order: str = "little") -> int:
        """Control (run), status (halted, idle, error), address and length of a channel; 0 for the rest."""
        del word_order
        base = 0x30 if offset >= 0x30 else 0
        channel = self.channels[base]
        if channel is None or not super()._address(offset, length):
            return 0
        status = int(not channel.running) | channel.idle << 1 | channel.error << 4
        known = {0x00: int(channel.running), 0x04: status, 0x18: channel.address, 0x1C: channel.address >> 32}
        return {**known, 0x28: channel.transferred}.get(offset - base, 0) & ((1 << 8 * length) - 1)

    def write(self, offset: int, data: Any) -> None:
        """Not possible."""
        said = "a DMA's registers are the driver's"
        raise NotImplementedError(f"{said} ({offset:#x} = {data}): transfer, start and stop")


class DMA(DefaultIP):
    """An AXI DMA: `sendchannel` and `recvchannel`; one that the design has not is None."""

    bindto = ("xilinx.com:ip:axi_dma:7.1",)

    def __init__(self, description: Description) -> None:
        super().__init__(description)
        there = {way: _Channel(stream) for way, stream in description["channels"].items()}
        self.sendchannel, self.recvchannel = there.get("mm2s"), there.get("s2mm")
        self.mmio = _Engine(description["phys_addr"], description["addr_range"])
        self.mmio.channels = {0x00: self.sendchannel, 0x30: self.recvchannel}

# SPDX-License-Identifier: Apache-2.0
"""`DMA`: `transfer` and `wait` over the streams of an AXI DMA, whose registers the kernel's driver keeps."""

from __future__ import annotations

import threading
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from cm.client.frame import Frame
from cm.client.stream import Stream
from cm.client.writer import Writer
from cm.errors import CmError, Timeout
from cm.pynq.board import board, places
from cm.pynq.buffer import PynqBuffer
from cm.pynq.interrupt import SLICE, until
from cm.pynq.mmio import MMIO
from cm.pynq.overlay import DefaultIP, Description

_Bytes = npt.NDArray[np.uint8]
_SHORT = 0.02  # seconds that what follows a transfer keeps others from the stream


class _Channel:
    """One direction. A transfer is copied between the buffer and a slot of the stream."""

    def __init__(self, stream: str) -> None:
        self._name = stream
        self._length = 0  # of the frames that the stream is set to; 0: it is not open
        self._under_way: _Bytes | None = None
        self._failed = ""
        self._began = False
        self.running = True
        self.transferred = 0
        self.address = 0  # of the last transfer's first byte, for the device
        self._lock = threading.Lock()  # of the stream: what follows a transfer, or who waits for it, has it

    @property
    def idle(self) -> bool:
        """Whether no transfer is under way; False before the first, as the hardware's bit."""
        return self._began and self._ended(0.0)

    @property
    def error(self) -> bool:
        """Whether the last transfer failed; `wait` says why."""
        return bool(self._failed)

    def start(self) -> None:
        """Let transfers begin, after `stop`."""
        self.running, self._failed = True, ""

    def stop(self) -> None:
        """Give the stream back, until `start`; a transfer under way is given up."""
        self.close()
        self.running = False

    def transfer(self, array: PynqBuffer, start: int = 0, nbytes: int = 0, cyclic: bool = False) -> None:
        """Begin to transfer `nbytes` (0: the rest) of a buffer of `allocate`, from byte `start` on.

        Raises RuntimeError while another is under way, ValueError for bytes that are not the buffer's.
        """
        if cyclic:
            raise NotImplementedError("transfer(cyclic=True): cm.connect().configure_stream(name, cyclic=True) has it")
        if not self.running:
            raise RuntimeError("DMA channel not started")
        if not self._ended(0.0):
            raise RuntimeError("DMA channel not idle")
        part = _part(array, start, nbytes)
        if part.nbytes != self._length:
            self.close()
            self._open(part.nbytes)
            self._length = part.nbytes
            places().until_load.add(self)
        self.transferred, self._failed = 0, ""
        self.address = array.physical_address + start
        self._begin(part)
        self._under_way, self._began = part, True
        self._follow()

    def wait(self) -> None:
        """Until the transfer has ended. Raises RuntimeError with the reason if it failed."""
        self._check()
        while not self._ended(SLICE):
            pass
        if self._failed:
            raise RuntimeError(self._failed)

    async def wait_async(self) -> None:
        """As `wait`, while other tasks run."""
        self._check()
        await until(lambda: self._ended(SLICE))
        self.wait()

    def _check(self) -> None:
        if not (self.running and self._began):
            raise RuntimeError("DMA channel not started" if not self.running else "no transfer was begun")

    def _ended(self, seconds: float) -> bool:
        """Whether it has ended, well or not, within so many seconds."""
        if self._under_way is None:
            return True
        if not self._lock.acquire(timeout=seconds):
            return False
        try:
            return self._under_way is None or self._ended_here(seconds)
        finally:
            self._lock.release()

    def _ended_here(self, seconds: float) -> bool:
        assert self._under_way is not None
        try:
            self.transferred = self._end(self._under_way, seconds)
        except Timeout:
            return False
        except CmError as error:
            self._failed = str(error)
        self._under_way = None
        return True

    def _follow(self) -> None:
        """What is sent has left the buffer already."""

    def _open(self, length: int) -> None:
        """Open the stream with frames of so many bytes."""
        raise NotImplementedError

    def _begin(self, part: _Bytes) -> None:
        """Begin to send; what is received has slots ready."""

    def _end(self, part: _Bytes, seconds: float) -> int:
        """How many bytes went. Raises Timeout while it goes on, CmError if it failed."""
        raise NotImplementedError

    def close(self) -> None:
        """Give the stream back; a transfer under way is given up."""
        with self._lock:
            if self._length:
                self._let_go()
            self._length, self._under_way = 0, None

    def _let_go(self) -> None:
        """Close the stream."""
        raise NotImplementedError


class _SendChannel(_Channel):
    _writer: Writer

    def _open(self, length: int) -> None:
        board().configure_stream(self._name, shape=(length,), dtype="uint8", force=True)
        self._writer = board().writer(self._name)

    def _begin(self, part: _Bytes) -> None:
        self._writer.write(part)

    def _end(self, part: _Bytes, seconds: float) -> int:
        self._writer.flush(seconds)
        return part.nbytes

    def _let_go(self) -> None:
        self._writer.close()


class _RecvChannel(_Channel):
    _stream: Stream
    _errors = 0  # of the stream, since it was opened
    _kept: Frame | None = None  # came after a transfer that failed

    def _open(self, length: int) -> None:
        # Backpressure: what comes between two transfers waits in the logic, as with an engine that is not started.
        board().configure_stream(self._name, shape=(length,), dtype="uint8", backpressure=True, force=True)
        self._stream, self._errors = board().stream(self._name, depth=2), 0
        self._stream.open()

    def _end(self, part: _Bytes, seconds: float) -> int:
        frame, self._kept = self._kept, None
        if frame is None:
            frame = self._read(seconds)
            if frame.info.failed:
                self._kept = frame
                raise CmError(f"stream {self._name!r}: the transfer failed")
        length = frame.nbytes
        part[:length] = np.asarray(frame).reshape(-1)
        frame.release()
        return length

    def _read(self, seconds: float) -> Frame:
        try:
            return self._stream.read(seconds)
        except Timeout:
            found = [stream for stream in board().status.streams if stream.name == self._name] if seconds else []
            for stream in found:
                if stream.errors > self._errors:
                    self._errors = stream.errors
                    why = stream.last_error.message if stream.last_error else "the transfer failed"
                    raise CmError(f"stream {self._name!r}: {why}") from None
            raise

    def _follow(self) -> None:
        """Have what comes in the buffer without anybody who waits, as PYNQ's programs may expect."""
        threading.Thread(target=self._fill, daemon=True).start()

    def _fill(self) -> None:
        while not self._ended(_SHORT):
            pass

    def _let_go(self) -> None:
        self._stream.close()
        self._kept = None


class _Engine(MMIO):
    """What the registers of the engine read as (PG021), by the transfers; the driver has the real ones."""

    def __init__(self, dma: DMA) -> None:
        super().__init__(dma.description["phys_addr"], dma.description["addr_range"])
        self._channels = {0x00: dma.sendchannel, 0x30: dma.recvchannel}

    def read(self, offset: int = 0, length: int = 4, word_order: str = "little") -> int:
        """Control (run), status (halted, idle, error), address and length of a channel; 0 for the rest."""
        del word_order
        channel = self._channels[0x30 if offset >= 0x30 else 0]
        at = offset - (0x30 if offset >= 0x30 else 0)
        if channel is None:
            return 0
        found = {
            0x00: int(channel.running),
            0x04: int(not channel.running) | channel.idle << 1 | channel.error << 4,
            0x18: channel.address,
            0x28: channel.transferred,
        }
        wide = found[0x18] >> 32 if at == 0x1C else found.get(at, 0)
        return wide & ((1 << 8 * length) - 1)

    def write(self, offset: int, data: Any) -> None:
        """Not possible."""
        raise NotImplementedError(
            f"a DMA's registers are the driver's ({offset:#x} = {data}): transfer, start and stop"
        )


class DMA(DefaultIP):
    """An AXI DMA: `sendchannel` and `recvchannel`; one that the design has not is None."""

    bindto: ClassVar[list[str]] = ["xilinx.com:ip:axi_dma:7.1"]

    def __init__(self, description: Description) -> None:
        super().__init__(description)
        channels = description["channels"]
        self.sendchannel = _SendChannel(channels["mm2s"]) if "mm2s" in channels else None
        self.recvchannel = _RecvChannel(channels["s2mm"]) if "s2mm" in channels else None
        self.mmio = _Engine(self)


def _part(array: Any, start: int, nbytes: int) -> _Bytes:
    """The bytes of a buffer that a transfer is about."""
    if not isinstance(array, PynqBuffer):
        raise TypeError(f"a DMA transfers buffers of allocate(), not {type(array).__name__}")
    _ = array.physical_address  # raises for what lies in ordinary memory
    if not array.flags.c_contiguous:
        raise ValueError("a DMA transfers bytes that follow each other, which those of a strided view do not")
    whole = np.asarray(array).reshape(-1).view(np.uint8)
    length = nbytes or whole.nbytes - start
    if start < 0 or length <= 0 or start + length > whole.nbytes:
        raise ValueError(f"{length} bytes from byte {start} on are not in a buffer of {whole.nbytes}")
    return whole[start : start + length]

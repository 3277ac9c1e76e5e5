# SPDX-License-Identifier: Apache-2.0
"""Between DMA completions and whoever takes or gives frames: one pump per open stream.

A reading pump keeps the channel's queue full: a slot goes back to the channel as soon as its frame was
handed on. Everything runs in the loop's thread.
"""

from __future__ import annotations

import errno
import os
import statistics
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cm.daemon.loop import Loop, Timer
from cm.device import AxiDma, Completion, DeviceGone, DmaBuffer
from cm.errors import Busy, CmError, InvalidRequest, Timeout
from cm.messages.status import FrameInfo, StreamStatus
from cm.schema.model import Stream

_FLAT = 1 << 20  # bytes of a slot where neither schema nor channel says how long a frame is
_WAITING = 32  # writes that may wait for a slot
_WRITE_TIMEOUT = 5.0  # seconds for the hardware to take a written frame
_LINGER = 2.0  # seconds that a stream stays open after a single read


class StreamStopped(Busy):
    """The stream was stopped (its region is being changed) before the transfer ended."""

    code = "stream_stopped"


class TransferFailed(CmError):
    """The DMA reported an error."""

    code = "transfer_failed"


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its description and its bytes, which are valid during the call only."""

    info: FrameInfo
    data: memoryview


Deliver = Callable[[Frame], None]
Done = Callable[[Frame | CmError], None]
Lost = Callable[[str, Exception], None]


class Pump(Protocol):
    """What all pumps have."""

    @property
    def busy(self) -> bool:
        """Whether somebody waits for it, so that it must stay open."""

    def label(self, config: str, mode: str) -> None:
        """Frames from here on belong to this mode."""

    def status(self) -> StreamStatus:
        """The stream and its counters."""

    def close(self) -> None:
        """Stop the channel and release everything."""


class _Base:
    """What reading and writing share: the channel, its slots, and the counters."""

    def __init__(self, loop: Loop, dma: AxiDma, stream: Stream, lost: Lost) -> None:
        from cm.daemon.streams import frame_bytes

        self._loop = loop
        self._dma = dma
        self._stream = stream
        self._lost = lost
        self._names = ("", "")
        self._frames = self._errors = self._dropped = self._sequence = 0
        self._times: deque[float] = deque(maxlen=64)
        self._latencies: deque[float] = deque(maxlen=64)
        self._shape_bytes = frame_bytes(stream)
        self._slot_bytes = self._slot_length()
        self._slots = self._allocate()
        loop.add(dma.fileno(), self._guarded)

    def _slot_length(self) -> int:
        info = self._dma.info
        length = self._shape_bytes or info.frame_length or min(_FLAT, info.max_length)
        if length > info.max_length:
            name = self._stream.name
            raise InvalidRequest(
                f"stream {name!r}: a frame has {length} bytes, channel {info.name} moves {info.max_length} at most"
            )
        return length

    def _allocate(self) -> list[DmaBuffer]:
        count = max(1, min(self._stream.slots, self._dma.info.queue_depth))
        slots: list[DmaBuffer] = []
        try:
            for _ in range(count):
                slots.append(self._dma.allocate(self._slot_bytes))
        except BaseException:
            for slot in slots:
                slot.close()
            raise
        return slots

    def label(self, config: str, mode: str) -> None:
        self._names = (config, mode)

    def status(self) -> StreamStatus:
        s = self._stream
        return StreamStatus(
            name=s.name,
            channel=s.channel,
            direction=s.direction.value,
            shape=s.shape or (),
            dtype=s.dtype,
            slots=len(self._slots),
            open=True,
            frames=self._frames,
            dropped=self._dropped,
            errors=self._errors,
            rate=self._rate(),
            latency_us=statistics.median(self._latencies) if self._latencies else 0.0,
        )

    def _rate(self) -> float:
        now = time.monotonic()
        recent = [t for t in self._times if t > now - 1.0]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else float(len(recent))

    def _count(self, timestamp_ns: int) -> None:
        self._frames += 1
        self._times.append(time.monotonic())
        self._latencies.append((time.monotonic_ns() - timestamp_ns) / 1000)

    def _info(self, completion: Completion) -> FrameInfo:
        whole = completion.length == self._shape_bytes and self._stream.shape is not None
        return FrameInfo(
            stream=self._stream.name,
            sequence=self._sequence,
            timestamp_ns=completion.timestamp_ns,
            length=completion.length,
            shape=self._stream.shape if whole and self._stream.shape else (completion.length,),
            dtype=self._stream.dtype if whole else "uint8",
            config_name=self._names[0],
            mode=self._names[1],
        )

    def _guarded(self) -> None:
        try:
            for completion in self._dma.completions():
                self._completed(completion)
        except OSError as error:
            self._lost(self._stream.name, error)

    def _completed(self, completion: Completion) -> None:
        raise NotImplementedError

    def close(self) -> None:
        self._loop.remove(self._dma.fileno())
        try:
            self._dma.cancel()
        except (CmError, OSError) as error:
            if not isinstance(error, DeviceGone):
                raise
        finally:
            for slot in self._slots:
                slot.close()
            self._dma.close()


class ReadPump(_Base):
    """S2MM: frames from the hardware to the sinks."""

    def __init__(self, loop: Loop, dma: AxiDma, stream: Stream, deliver: Deliver, lost: Lost) -> None:
        super().__init__(loop, dma, stream, lost)
        self._deliver = deliver
        self._readers: deque[tuple[Done, Timer]] = deque()
        self._read_at = 0.0
        for cookie, slot in enumerate(self._slots):
            self._dma.submit(slot, 0, self._slot_bytes, cookie)

    @property
    def busy(self) -> bool:
        return bool(self._readers) or time.monotonic() < self._read_at + _LINGER

    def read_once(self, timeout: float, done: Done) -> None:
        """Hand the next frame to `done`, or a Timeout after `timeout` seconds."""
        entry: list[tuple[Done, Timer]] = []

        def expired() -> None:
            if entry[0] in self._readers:
                self._readers.remove(entry[0])
                done(Timeout(f"stream {self._stream.name!r} gave no frame within {timeout:g} s"))

        entry.append((done, self._loop.call_later(timeout, expired)))
        self._readers.append(entry[0])
        self._read_at = time.monotonic()

    def _completed(self, completion: Completion) -> None:
        if completion.status == -errno.ECANCELED:
            return
        slot = self._slots[completion.cookie]
        if completion.ok:
            self._hand_on(slot, completion)
        else:
            self._errors += 1
        self._dma.submit(slot, 0, self._slot_bytes, completion.cookie)

    def _hand_on(self, slot: DmaBuffer, completion: Completion) -> None:
        slot.sync_begin(write=False)
        frame = Frame(self._info(completion), slot.memoryview(writable=False)[: completion.length])
        self._sequence += 1
        while self._readers:
            done, timer = self._readers.popleft()
            timer.cancel()
            done(frame)
        self._deliver(frame)
        slot.sync_end(write=False)
        self._count(completion.timestamp_ns)

    def close(self) -> None:
        super().close()
        while self._readers:
            done, timer = self._readers.popleft()
            timer.cancel()
            done(StreamStopped(f"stream {self._stream.name!r} was stopped before a frame came"))


class WritePump(_Base):
    """MM2S: written frames to the hardware."""

    def __init__(self, loop: Loop, dma: AxiDma, stream: Stream, deliver: Deliver, lost: Lost) -> None:  # noqa: ARG002
        super().__init__(loop, dma, stream, lost)
        self._free = deque(range(len(self._slots)))
        self._under_way: dict[int, tuple[Done, Timer]] = {}
        self._waiting: deque[tuple[bytes | memoryview, Done]] = deque()

    @property
    def busy(self) -> bool:
        return True  # a writer has no subscription to tell by; closed with its mode

    def write(self, data: bytes | memoryview, done: Done) -> None:
        """Send a frame. Raises InvalidRequest for a wrong size, Busy when too many wait."""
        self._check_size(memoryview(data).nbytes)
        if self._free:
            self._send(self._free.popleft(), data, done)
        elif len(self._waiting) < _WAITING:
            self._waiting.append((data, done))
        else:
            self._dropped += 1
            raise Busy(f"stream {self._stream.name!r}: {_WAITING} frames wait already; the hardware takes none")

    def _check_size(self, size: int) -> None:
        name = self._stream.name
        if self._shape_bytes and size != self._shape_bytes:
            frame = f"{'×'.join(map(str, self._stream.shape or ()))} {self._stream.dtype}"
            raise InvalidRequest(
                f"stream {name!r} takes frames of {frame}, {self._shape_bytes} bytes; this one has {size}"
            )
        if not 0 < size <= self._slot_bytes:
            raise InvalidRequest(f"stream {name!r} takes 1 to {self._slot_bytes} bytes; this frame has {size}")

    def _send(self, index: int, data: bytes | memoryview, done: Done) -> None:
        view = memoryview(data).cast("B")
        slot = self._slots[index]
        slot.sync_begin(write=True)
        slot.memoryview()[: view.nbytes] = view
        slot.sync_end(write=True)
        timer = self._loop.call_later(_WRITE_TIMEOUT, lambda: self._stuck(index))
        self._under_way[index] = (done, timer)
        self._dma.submit(slot, 0, view.nbytes, index)

    def _stuck(self, index: int) -> None:
        """The slot stays with the hardware; only the caller is told."""
        if index in self._under_way:
            done, timer = self._under_way[index]
            self._under_way[index] = (lambda _: None, timer)
            self._errors += 1
            done(
                Timeout(
                    f"stream {self._stream.name!r}: the hardware took no data for {_WRITE_TIMEOUT:.0f} s; "
                    "is somebody reading what comes out, and is the region coupled?"
                )
            )

    def _completed(self, completion: Completion) -> None:
        done, timer = self._under_way.pop(completion.cookie)
        timer.cancel()
        if completion.ok:
            self._count(completion.timestamp_ns)
            done(Frame(self._info(completion), memoryview(b"")))
            self._sequence += 1
        else:
            self._errors += 1
            done(_failure(self._stream.name, completion))
        self._free.append(completion.cookie)
        if self._waiting:
            data, waiting = self._waiting.popleft()
            self._send(self._free.popleft(), data, waiting)

    def close(self) -> None:
        super().close()
        stopped = StreamStopped(f"stream {self._stream.name!r} was stopped before the frame was taken")
        for done, timer in self._under_way.values():
            timer.cancel()
            done(stopped)
        for _, done in self._waiting:
            done(stopped)
        self._under_way.clear()
        self._waiting.clear()


def _failure(stream: str, completion: Completion) -> CmError:
    if completion.status == -errno.ECANCELED:
        return StreamStopped(f"stream {stream!r} was stopped before the frame was taken")
    return TransferFailed(f"stream {stream!r}: the DMA reported {os.strerror(-completion.status)}")

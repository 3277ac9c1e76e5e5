# SPDX-License-Identifier: Apache-2.0
"""DMA channels: queues of transfers over a client's buffers, and their completions."""

from __future__ import annotations

import errno
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import TypeAlias

from cm.schema.model import Direction
from cm.simulation.software.errors import NodeError
from cm.simulation.software.hardware.board_spec import ChannelSpec
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.buffers import Buffer, Buffers, DmaMemory
from cm.simulation.software.transport.session import Events
from cm.wire.lazy_numpy import NDArray, np

QUEUE_DEPTH = 64
MAX_LENGTH = (1 << 26) - 1  # the AXI DMA's length register has at most 26 bits (PG021)
MAX_LINE = (1 << 16) - 1  # the VDMA's HSIZE has 16 (PG020)
Bytes: TypeAlias = "NDArray[np.uint8]"


class Transfer:
    """One descriptor: a run of bytes or a frame of lines in a buffer."""

    __slots__ = ("buffer", "cookie", "cyclic", "done", "handle", "length", "offset", "period", "position", "view")

    def __init__(
        self, buffer: Buffer, view: Bytes, cookie: int, period: int = 0, at: tuple[int, int] | None = None
    ) -> None:
        """`at` is the place that the client gave: handle and offset."""
        self.buffer = buffer
        self.handle, self.offset = at or (0, 0)
        self.view = view  # one dimension, or (lines, bytes of a line)
        self.cookie = cookie
        self.length = view.size
        self.cyclic = period > 0
        self.period = period or self.length
        self.position = 0
        self.done: Callable[[int, int], object] | None = None  # told in place of the file, with bytes and status

    @property
    def plain(self) -> bool:
        """Whether it is a run of bytes that is moved once."""
        return self.handle > 0 and self.view.ndim == 1 and not self.cyclic

    def data(self) -> Bytes:
        """The bytes to send; copied only if there are gaps between lines."""
        if self.view.ndim > 1:
            return np.ascontiguousarray(self.view).reshape(-1)
        return self.view[self.position : self.position + self.period]

    def store(self, data: Bytes) -> int:
        """Put what arrived into memory; returns how many bytes fit."""
        length = min(len(data), self.period)
        if self.view.ndim > 1:
            _store_lines(self.view, data[:length])
        else:
            self.view[self.position : self.position + length] = data[:length]
        return length

    def advance(self) -> None:
        """Go on to the next period, cyclically."""
        self.position = (self.position + self.period) % self.length


def _store_lines(view: Bytes, data: Bytes) -> None:
    lines, rest = divmod(len(data), view.shape[1])
    view[:lines] = data[: lines * view.shape[1]].reshape(lines, view.shape[1])
    if rest:
        view[lines, :rest] = data[lines * view.shape[1] :]


class Completions:
    """The completion queue of one open file."""

    def __init__(self, events: Events) -> None:
        self.events = events
        self.sequence = 0
        self.read = 0
        self._lost = False

    def send(self, cookie: int, length: int, status: int, flags: int = 0) -> None:
        """One more completion."""
        now = time.monotonic_ns()
        self.events.send(protocol.DMA_COMPLETION.pack(cookie, length, now, self.sequence, status, flags))
        self.sequence += 1

    def send_period(self, cookie: int, length: int, periods: int) -> None:
        """A period of a cyclic transfer: lost, and counted, if the client is a whole round behind."""
        if not self.room(periods):
            self.sequence += 1
            self._lost = True
            return
        flags = protocol.COMPLETION_OVERRUN if self._lost else 0
        self._lost = False
        self.send(cookie, length, 0, flags)

    def room(self, limit: int) -> bool:
        """Whether fewer than `limit` completions wait to be read."""
        if self.events.sent - self.read < limit:
            return True
        self.read = self.events.sent - self.events.unread()
        return self.events.sent - self.read < limit


class Channel:
    """The hardware of a channel: what is queued, and the file that has it open."""

    def __init__(self, spec: ChannelSpec) -> None:
        self.spec = spec
        self.queue: deque[Transfer] = deque()
        self.completions: Completions | None = None  # of the file that has it open
        self._buffers: Buffers | None = None  # of that file
        self.kick: Callable[[], None] = lambda: None
        self.moved = 0

    def claim(self, completions: Completions, buffers: Buffers) -> None:
        """An open file takes the channel (EBUSY)."""
        if self.completions is not None:
            raise NodeError(errno.EBUSY, f"{self.spec.name} is open already")
        self.completions, self._buffers = completions, buffers

    def usable(self) -> Iterator[tuple[int, Buffer]]:
        """The buffers that the channel may use, by handle."""
        assert self._buffers is not None
        reads = self.spec.direction is Direction.MM2S
        return ((handle, buffer) for handle, buffer in self._buffers if reads or buffer.writable)

    @property
    def coherent(self) -> bool:
        """Whether the processor's caches see its buffers without synchronisation."""
        return self._buffers is None or all(buffer.counters is None for _, buffer in self._buffers)

    def release(self) -> None:
        """The file is closed: nothing runs any more."""
        for transfer in self.queue:
            transfer.buffer.inflight -= 1
        self.queue.clear()
        self.completions = self._buffers = None

    def submit(self, transfer: Transfer) -> None:
        """Queue a transfer (EBUSY when the queue is full)."""
        assert self.completions is not None
        waiting = len(self.queue)
        if waiting >= QUEUE_DEPTH or not self.completions.room(QUEUE_DEPTH - waiting):
            raise NodeError(errno.EBUSY, "the queue is full: read completions first")
        transfer.buffer.inflight += 1
        if transfer.buffer.counters is not None and self._buffers is not None:
            self._buffers.syncs.submitted(transfer.buffer.counters)
        self.queue.append(transfer)
        self.kick()

    def begin(self, memory: DmaMemory, address: int, length: int, done: Callable[[int, int], object]) -> None:
        """Start the engine by its registers. Raises NodeError for no length or while it moves, SimError."""
        self.kick()  # what is queued is known here
        length &= (1 << self.spec.simple) - 1 if self.spec.simple else MAX_LENGTH
        if not length or self.queue:
            raise NodeError(errno.EBUSY if length else errno.EINVAL, "nothing is to be moved, or something is already")
        buffer, offset = memory.at(address, length)
        transfer = Transfer(buffer, buffer.bytes[offset : offset + length], 0)
        transfer.done = done
        buffer.inflight += 1
        self.queue.append(transfer)

    def cancel(self) -> None:
        """End all transfers with ECANCELED."""
        while self.queue:
            self._finish(self.queue[0], 0, -errno.ECANCELED)

    def complete(self, length: int, status: int = 0) -> None:
        """The transfer at the head has moved `length` bytes, or failed."""
        transfer = self.queue[0]
        if self.spec.blind and status == 0:
            length = transfer.length
        self.moved += length
        if transfer.cyclic and status == 0:
            assert self.completions is not None
            self.completions.send_period(transfer.cookie, length, transfer.length // transfer.period)
            transfer.advance()
        else:
            self._finish(transfer, length, status)

    def _finish(self, transfer: Transfer, length: int, status: int) -> None:
        self.queue.popleft()
        transfer.buffer.inflight -= 1
        if transfer.done is not None:
            transfer.done(length, status)
        elif self.completions is not None:
            self.completions.send(transfer.cookie, length, status)

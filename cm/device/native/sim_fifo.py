# SPDX-License-Identifier: Apache-2.0
"""The simulated board's fast path (``csrc/sim_fifo.h``): two channels lent to a thread, and taken back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, last_error

QUEUE: int = lib.CM_SIM_QUEUE


class Entry(NamedTuple):
    """``struct cm_sim_transfer``."""

    handle: int
    offset: int
    length: int
    cookie: int


class Counts(NamedTuple):
    """What a channel has sent: completions, how many of them are known to be read, the next number, bytes moved."""

    sent: int
    read: int
    sequence: int
    moved: int


class Lent(NamedTuple):
    """A channel to lend: descriptors, memory by handle (kept while it is lent), counts, what is queued."""

    request_fd: int
    event_fd: int
    packet_cost: int
    buffers: Mapping[int, Any]
    counts: Counts
    queue: Sequence[Entry]


class Returned(NamedTuple):
    """A channel that was lent; `owed` is the payload of a submit that has yet to be answered."""

    counts: Counts
    queue: Sequence[Entry]
    owed: bytes | None


class Fifo:
    """A FIFO between two channels, with a thread; `close` ends it."""

    def __init__(self) -> None:
        self._fifo: Handle = lib.cm_sim_fifo_new()
        if self._fifo == ffi.NULL:
            raise last_error()
        self._lent: list[tuple[Handle, Handle, list[Handle]]] = []

    @property
    def running(self) -> bool:
        """Whether it has the channels; they have to be taken back with `park` even if it parked by itself."""
        return bool(self._lent)

    def fileno(self) -> int:
        """Polls readable once the thread has parked by itself."""
        return int(lib.cm_sim_fifo_event_fd(self._fifo))

    def run(self, source: Lent, sink: Lent) -> None:
        """Lend both channels. Raises OSError."""
        lent = [_channel(source), _channel(sink)]
        check(lib.cm_sim_fifo_run(self._fifo, lent[0][0], lent[1][0]))
        self._lent = lent

    def park(self) -> tuple[Returned, Returned]:
        """Take the channels back: source and sink."""
        lib.cm_sim_fifo_park(self._fifo)
        source, sink = (_returned(raw) for raw, _, _ in self._lent)
        self._lent = []
        return source, sink

    def close(self) -> None:
        """End the thread."""
        lib.cm_sim_fifo_close(self._fifo)
        self._fifo = ffi.NULL


def _channel(lent: Lent) -> tuple[Handle, Handle, list[Handle]]:
    memory = [ffi.from_buffer("uint8_t[]", buffer) for buffer in lent.buffers.values()]
    table = ffi.new("struct cm_sim_buffer[]", len(memory))
    for place, handle, view in zip(table, lent.buffers, memory, strict=True):
        place.memory, place.length, place.handle = view, len(view), handle
    raw = ffi.new("struct cm_sim_channel *")
    raw.request_fd, raw.event_fd, raw.packet_cost = lent.request_fd, lent.event_fd, lent.packet_cost
    raw.buffers, raw.buffer_count = table, len(memory)
    raw.sent, raw.read, raw.sequence, raw.moved = lent.counts
    raw.count = len(lent.queue)
    for transfer, entry in zip(raw.queue, lent.queue, strict=False):
        transfer.handle, transfer.offset, transfer.length, transfer.cookie = entry
    return raw, table, memory


def _returned(raw: Handle) -> Returned:
    ring = (raw.queue[(raw.first + index) % QUEUE] for index in range(raw.count))
    queue = [Entry(t.handle, t.offset, t.length, t.cookie) for t in ring]
    owed = bytes(ffi.buffer(ffi.addressof(raw, "owed_submit"))) if raw.owed else None
    return Returned(Counts(raw.sent, raw.read, raw.sequence, raw.moved), queue, owed)

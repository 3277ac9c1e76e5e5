# SPDX-License-Identifier: Apache-2.0
"""Two channels that only pass on data, lent to a thread in C (``csrc/sim_fifo.h``) and taken back.

While they are lent, this process does not know what is queued: code that looks at the channels, or changes what
happens to their data, takes them back first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cm.device.native.sim_fifo import Counts, Entry, Fifo, Lent, Returned
from cm.loop import Loop
from cm.simulation.software.hardware.dma import Channel, Completions, Transfer
from cm.simulation.software.transport import protocol


class FastPath:
    """A thread for one pair of channels; it is started when they are first lent."""

    def __init__(self, loop: Loop, source: Channel, sink: Channel, parked: Callable[[], None]) -> None:
        """`parked` is called when the thread has given the channels back by itself."""
        self._loop, self._channels, self._parked = loop, (source, sink), parked
        self._fifo: Fifo | None = None
        self.lent = 0  # times

    def lend(self) -> bool:
        """Lend both channels, if they are open and everything queued is plain."""
        if not all(_lendable(channel) for channel in self._channels):
            return False
        if self._fifo is None:
            self._fifo = Fifo()
            self._loop.add(self._fifo.fileno(), self._has_parked)
        source, sink = (_lend(channel, self.take_back) for channel in self._channels)
        self._fifo.run(source, sink)
        self.lent += 1
        return True

    def take_back(self) -> None:
        """Take the channels back; harmless if they are not lent."""
        if self._fifo is None or not self._fifo.running:
            return
        for channel, returned in zip(self._channels, self._fifo.park(), strict=True):
            _restore(channel, returned)

    def close(self) -> None:
        """End the thread."""
        self.take_back()
        if self._fifo is not None:
            self._loop.remove(self._fifo.fileno())
            self._fifo.close()
            self._fifo = None

    def _has_parked(self) -> None:
        self.take_back()
        self._parked()


def _lendable(channel: Channel) -> bool:
    if channel.spec.vdma or channel.spec.simple or not channel.coherent:  # each of their transfers is looked at
        return False
    completions = channel.completions
    if completions is None or completions.events.line is None or not completions.events.line.lendable:
        return False
    return all(transfer.plain for transfer in channel.queue)


def _lend(channel: Channel, take_back: Callable[[], None]) -> Lent:
    completions = _completions(channel)
    events = completions.events
    assert events.line is not None
    requests, sent = events.line.lend(take_back)
    buffers = {handle: buffer.bytes for handle, buffer in channel.usable()}
    counts = Counts(events.sent, completions.read, completions.sequence, channel.moved)
    return Lent(requests, sent, events.cost, buffers, counts, _emptied(channel))


def _emptied(channel: Channel) -> Sequence[Entry]:
    entries = []
    while channel.queue:
        transfer = channel.queue.popleft()
        transfer.buffer.inflight -= 1
        entries.append(Entry(transfer.handle, transfer.offset, transfer.length, transfer.cookie))
    return entries


def _restore(channel: Channel, returned: Returned) -> None:
    completions = _completions(channel)
    events, counts = completions.events, returned.counts
    events.sent, completions.read, completions.sequence, channel.moved = counts
    buffers = dict(channel.usable())
    for entry in returned.queue:
        buffer = buffers[entry.handle]
        view = buffer.bytes[entry.offset : entry.offset + entry.length]
        buffer.inflight += 1
        channel.queue.append(Transfer(buffer, view, entry.cookie, at=(entry.handle, entry.offset)))
    assert events.line is not None
    events.line.returned(protocol.DMA_IOC_SUBMIT, returned.owed)


def _completions(channel: Channel) -> Completions:
    assert channel.completions is not None
    return channel.completions

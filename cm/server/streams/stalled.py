# SPDX-License-Identifier: Apache-2.0
"""Streams whose channel does not answer (a stopped simulated board), so that no request waits for it twice."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterable

from cm.device import AxiDma
from cm.schema.model import Stream


class StalledChannels:
    """Remembers channels by their stream's name until they answer. Used in the loop's thread."""

    def __init__(self, probe: Callable[[str], int]) -> None:
        """`probe` makes a descriptor that polls readable when a channel answers."""
        self._probe = probe
        self._channels: dict[str, AxiDma] = {}  # open; an answer is overdue
        self._probes: dict[str, int] = {}  # could not be opened

    def begin(self, name: str, channel: AxiDma) -> None:
        """Take over an open channel that did not answer."""
        self._channels[name] = channel

    def probe(self, stream: Stream) -> None:
        """Watch a channel that could not be opened because nothing answered. Raises OSError if it cannot be watched."""
        self._probes[stream.name] = self._probe(stream.channel)

    def answered(self) -> list[str]:
        """Release the channels that answer again and can be reopened, and return their names. Does not block."""
        back = [name for name, channel in self._channels.items() if channel.answers]
        for name in back:
            self._channels.pop(name).close()
        ready = _readable(self._probes.values())
        probed = [name for name, descriptor in self._probes.items() if descriptor in ready]
        for name in probed:
            os.close(self._probes.pop(name))
        return [*back, *probed]

    def close(self) -> None:
        """Close all channels and probes."""
        for channel in self._channels.values():
            channel.close()
        for descriptor in self._probes.values():
            os.close(descriptor)
        self._channels.clear()
        self._probes.clear()


def _readable(descriptors: Iterable[int]) -> set[int]:
    poll = select.poll()
    for descriptor in descriptors:
        poll.register(descriptor, select.POLLIN)
    return {descriptor for descriptor, _ in poll.poll(0)}

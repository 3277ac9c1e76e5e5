# SPDX-License-Identifier: Apache-2.0
"""Streams whose channel does not answer: a simulated board that is stopped. Nobody waits for it twice."""

from __future__ import annotations

import os
import select
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress

from cm.device import AxiDma, DeviceTimeout
from cm.schema.model import Stream


class Silence:
    """Remembers channels by their stream's name, until they answer. The loop's thread."""

    def __init__(self, probe: Callable[[str], int]) -> None:
        """`probe` makes a descriptor that polls readable when a channel answers."""
        self._probe = probe
        self._channels: dict[str, AxiDma] = {}  # open; an answer is overdue
        self._probes: dict[str, int] = {}  # could not be opened

    def of(self, name: str) -> bool:
        """Whether a stream's channel is known not to answer."""
        return name in self._channels or name in self._probes

    def begin(self, name: str, channel: AxiDma) -> None:
        """An open channel did not answer; it is ours from here on."""
        self._channels[name] = channel

    @contextmanager
    def noticed(self, stream: Stream) -> Iterator[None]:
        """Around opening a stream's channel."""
        try:
            yield
        except DeviceTimeout:
            with suppress(OSError):  # then the next who opens it finds out anew
                self._probes[stream.name] = self._probe(stream.channel)
            raise

    def look(self) -> None:
        """Let go of channels that answer again: they can be opened anew. Does not block."""
        for name, channel in list(self._channels.items()):
            if channel.answers:
                del self._channels[name]
                channel.close()
        ready = _readable(self._probes.values())
        for name, descriptor in list(self._probes.items()):
            if descriptor in ready:
                os.close(self._probes.pop(name))

    def close(self) -> None:
        """Close all."""
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

# SPDX-License-Identifier: Apache-2.0
"""DMA buffers that hold images for a port."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cm.manager.loaders.job import Job
from cm.manager.ports import ConfigPort, Image, PortBuffer

_PAGE = 4096
_Key = tuple[str | None, str]


@dataclass(frozen=True, slots=True)
class Held:
    """A DMA buffer with an image's words; it may be longer than they are."""

    buffer: PortBuffer
    length: int


class BufferCache:
    """DMA buffers that hold images for a port, least recently used out first, within a budget of bytes.

    A repeated change finds its image here and does no file I/O.
    """

    def __init__(self, budget: int, close: Callable[[Held], None]) -> None:
        self._budget = budget
        self._close = close
        self._held: OrderedDict[_Key, Held] = OrderedDict()

    def get(self, job: Job, icap: ConfigPort, read: Callable[[Image], bytes]) -> tuple[Held, bool]:
        """A buffer with the image's words, and whether it stays here (else the caller closes it)."""
        key, image = _key(job), job.image
        held = self._held.get(key)
        if held is not None:
            self._held.move_to_end(key)
            return held, True
        new = _filled(icap, read(image))
        if new.buffer.length > self._budget:
            return new, False
        while self._held and self.bytes + new.buffer.length > self._budget:
            self._close(self._held.popitem(last=False)[1])
        self._held[key] = new
        return new, True

    def keep_only(self, jobs: Iterable[Job]) -> None:
        """Close the buffers of all other images."""
        wanted = {_key(job) for job in jobs}
        for key in [k for k in self._held if k not in wanted]:
            self._close(self._held.pop(key))

    def has(self, job: Job) -> bool:
        """Whether the image is here."""
        return _key(job) in self._held

    def has_room(self, length: int) -> bool:
        """Whether a buffer of `length` bytes (buffers are whole pages) fits beside those that are here."""
        return self.bytes + -(-length // _PAGE) * _PAGE <= self._budget

    @property
    def bytes(self) -> int:
        """Bytes held now."""
        return sum(held.buffer.length for held in self._held.values())

    def clear(self) -> None:
        """Give everything back; the port may have gone."""
        while self._held:
            self._close(self._held.popitem()[1])


def _key(job: Job) -> _Key:
    """A buffer belongs to the port on which it was allocated."""
    return job.port, job.image.sha256


def _filled(icap: ConfigPort, data: bytes) -> Held:
    buffer = icap.allocate(len(data))
    try:
        buffer.sync_begin(write=True)
        buffer.memoryview()[: len(data)] = data
        buffer.sync_end(write=True)
    except BaseException:
        buffer.close()
        raise
    return Held(buffer, len(data))

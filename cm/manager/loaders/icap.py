# SPDX-License-Identifier: Apache-2.0
"""Loads through a DMA-fed configuration access port, from buffers that keep what may be loaded again."""

from __future__ import annotations

import itertools
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from cm.errors import Busy
from cm.manager.errors import LoadFailed, StepTimeout, WrongDevice
from cm.manager.interfaces import ConfigPort, Devices, Files, Image, PortBuffer, PortCompletion, TimeSource
from cm.manager.loaders.job import Job, OnBytes, Start

_POLL = 0.05  # seconds between two looks at a load's progress; most loads are shorter, and looking slows none
_REVISION = 0xF0000000  # bits of an IDCODE that differ between revisions of one device
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
        """A buffer with the image's words, and whether it is kept here (if not, the caller closes it)."""
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


class IcapLoader:
    """A DMA-fed ICAP: started without blocking, watched until its own end."""

    def __init__(self, devices: Devices, files: Files, time: TimeSource, budget: int) -> None:
        self._devices = devices
        self._files = files
        self._time = time
        self._cache = BufferCache(budget, self._dispose)
        self._in_use: list[Held] = []
        self._cookies = itertools.count(1)

    def prefetch(self, jobs: Sequence[Job], go_on: Callable[[], bool]) -> None:
        """Keep only these images' words in DMA buffers: the first ones, as many as fit in the budget."""
        self._cache.keep_only(jobs)
        for job in jobs:
            if not go_on():
                return
            if not self._cache.has(job) and self._cache.has_room(job.image.length):
                held, kept = self._cache.get(job, self._devices.icap(job.port), self._files.port_bytes)
                if not kept:
                    self._dispose(held)

    def check(self, job: Job) -> None:
        """The port is asked: whether it may be used, and for its device, so that no other's bitstream reaches it."""
        info = self._devices.icap(job.port).info
        if info.denied:
            raise LoadFailed(
                f"{job.image.path.name}: the platform's firmware does not let the ICAP be selected; build it with "
                "SECURE_ACCESS, or write loader: auto or fpga_manager"
            )
        there, wanted = info.idcode, job.image.idcode
        if there and wanted is not None and (there ^ wanted) & ~_REVISION:
            raise WrongDevice(
                f"{job.image.path}: made for IDCODE {wanted:#010x}, but the port is that of {there:#010x}"
            )

    @contextmanager
    def prepared(self, job: Job, timeout: float) -> Iterator[Start]:
        """The image in a DMA buffer, and the port idle."""
        icap = self._devices.icap(job.port)
        held, kept = self._cache.get(job, icap, self._files.port_bytes)
        try:
            self._await_idle(icap, job.image, timeout)
            yield lambda on_bytes: self._load(icap, held, job, timeout, on_bytes)
        finally:
            if not kept:
                self._dispose(held)

    def _load(self, icap: ConfigPort, held: Held, job: Job, timeout: float, on_bytes: OnBytes) -> None:
        image, cookie = job.image, next(self._cookies)
        whole = job.region is None
        icap.load(held.buffer, held.length, cookie=cookie, full=whole, encrypted=image.encrypted)
        _raise_failed(self._wait(icap, cookie, image, timeout, on_bytes), image)

    def _dispose(self, held: Held) -> None:
        """Close a buffer, and earlier ones that an abandoned load was still using then."""
        left = [*self._in_use, held]
        self._in_use = []
        for each in left:
            try:
                each.buffer.close()
            except Busy:
                self._in_use.append(each)

    def _await_idle(self, icap: ConfigPort, image: Image, timeout: float) -> None:
        """Wait for a load that was abandoned as hung and may still hold the port, until the driver ends it."""
        until = self._time.monotonic() + timeout
        while icap.status().loading:
            if self._time.monotonic() >= until:
                raise StepTimeout(
                    f"the port was busy with an earlier load for {timeout:.1f} s; {image.path.name} waits"
                )
            time.sleep(_POLL)

    def _wait(self, icap: ConfigPort, cookie: int, image: Image, timeout: float, on_bytes: OnBytes) -> PortCompletion:
        """The end of our load; that of an earlier one, abandoned as hung, is skipped."""
        until = self._time.monotonic() + timeout
        while self._time.monotonic() < until:
            try:
                completion = icap.wait(_POLL)
            except TimeoutError:
                on_bytes(icap.status().bytes_done)
            else:
                if completion.cookie == cookie:
                    return completion
        raise StepTimeout(f"the port took {image.path.name} for more than {timeout:.1f} s and did not finish")

    def forget(self) -> None:
        self._cache.clear()


def _raise_failed(completion: PortCompletion, image: Image) -> None:
    if completion.status != 0:
        raise LoadFailed(f"{image.path.name}: the configuration port reported {completion.reason}")

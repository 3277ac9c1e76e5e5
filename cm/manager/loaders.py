# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: a small interface and its implementations, one per `LoaderKind`."""

from __future__ import annotations

import itertools
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from cm.device import DeviceBusy, DmaBuffer, FpgaManager, Icap, IcapCompletion, IcapState
from cm.manager.errors import LoadFailed, StepTimeout
from cm.manager.ports import Clock, Devices, Files, Image
from cm.schema.model import Config, LoaderKind, Module, Region

_POLL = 0.02  # seconds between two looks at how far a load is

OnBytes = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Job:
    """An image and where it goes; region and module are None for the whole device."""

    config: Config
    image: Image
    region: Region | None = None
    module: Module | None = None

    @property
    def port(self) -> str | None:
        """The name of the port, where there are several."""
        return self.region.loader_name if self.region else None


class Loader(Protocol):
    """Loads one image. Returns when the port is done; raises LoadFailed, StepTimeout or DeviceError."""

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:
        """Do the job, telling `on_bytes` how far it is."""

    def forget(self) -> None:
        """The board was lost: drop what belongs to it."""


@dataclass(frozen=True, slots=True)
class Held:
    """A DMA buffer with an image's words; it may be longer than they are."""

    buffer: DmaBuffer
    length: int


class BufferCache:
    """DMA buffers of one port that hold images, least recently used out first, within a budget of bytes.

    A repeated change finds its image here and does no file I/O.
    """

    def __init__(self, budget: int, close: Callable[[Held], None]) -> None:
        self._budget = budget
        self._close = close
        self._held: OrderedDict[str, Held] = OrderedDict()

    def get(self, image: Image, icap: Icap, read: Callable[[Image], bytes]) -> tuple[Held, bool]:
        """A buffer with the image's words, and whether it stays here (else the caller closes it)."""
        held = self._held.get(image.sha256)
        if held is not None:
            self._held.move_to_end(image.sha256)
            return held, True
        new = _filled(icap, read(image))
        if new.buffer.length > self._budget:
            return new, False
        while self._held and self.bytes + new.buffer.length > self._budget:
            self._close(self._held.popitem(last=False)[1])
        self._held[image.sha256] = new
        return new, True

    @property
    def bytes(self) -> int:
        """Bytes held now."""
        return sum(held.buffer.length for held in self._held.values())

    def clear(self) -> None:
        """Give everything back; the port may have gone."""
        while self._held:
            self._close(self._held.popitem()[1])


def _filled(icap: Icap, data: bytes) -> Held:
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

    def __init__(self, devices: Devices, files: Files, clock: Clock, budget: int) -> None:
        self._devices = devices
        self._files = files
        self._clock = clock
        self._cache = BufferCache(budget, self._dispose)
        self._in_use: list[Held] = []
        self._cookies = itertools.count(1)

    def prefetch(self, job: Job) -> None:
        """Have the image's words in a DMA buffer, if the budget allows."""
        held, kept = self._cache.get(job.image, self._devices.icap(job.port), self._files.port_bytes)
        if not kept:
            self._dispose(held)

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:
        image = job.image
        icap = self._devices.icap(job.port)
        held, kept = self._cache.get(image, icap, self._files.port_bytes)
        try:
            cookie = next(self._cookies)
            self._await_idle(icap, image, timeout)
            icap.load(
                held.buffer,
                length=held.length,
                cookie=cookie,
                full=job.region is None,
                encrypted=image.report.encrypted,
            )
            _raise_failed(self._wait(icap, cookie, image, timeout, on_bytes), image)
        finally:
            if not kept:
                self._dispose(held)

    def _dispose(self, held: Held) -> None:
        """Close a buffer, and those that a load given up as hung still used the last time."""
        left = [*self._in_use, held]
        self._in_use = []
        for each in left:
            try:
                each.buffer.close()
            except DeviceBusy:
                self._in_use.append(each)

    def _await_idle(self, icap: Icap, image: Image, timeout: float) -> None:
        """A load that was given up as hung may still hold the port; the driver ends it in its own time."""
        until = self._clock.monotonic() + timeout
        while icap.status().state is IcapState.LOADING:
            if self._clock.monotonic() >= until:
                raise StepTimeout(
                    f"the port was busy with an earlier load for {timeout:.1f} s; {image.path.name} waits"
                )
            time.sleep(_POLL)

    def _wait(self, icap: Icap, cookie: int, image: Image, timeout: float, on_bytes: OnBytes) -> IcapCompletion:
        """The end of our load; that of an earlier one, given up as hung, is passed over."""
        until = self._clock.monotonic() + timeout
        while self._clock.monotonic() < until:
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


def _raise_failed(completion: IcapCompletion, image: Image) -> None:
    if completion.status != 0:
        raise LoadFailed(f"{image.path.name}: the configuration port reported {completion.reason}")


class FpgaManagerLoader:
    """The kernel's fpga_manager, by firmware name (linux-xlnx). Blocks until the kernel is done."""

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:  # noqa: ARG002 (the kernel has its own)
        manager: FpgaManager = self._devices.fpga_manager(job.port)
        name = self._files.firmware_name(job.image)
        manager.load(name, partial=job.region is not None, encrypted=job.image.report.encrypted)
        _raise_not_operating(manager, job.image)
        on_bytes(job.image.length)

    def forget(self) -> None:
        """Nothing is kept."""


def _raise_not_operating(manager: FpgaManager, image: Image) -> None:
    state = manager.state
    if state != "operating":
        raise LoadFailed(f"{image.path.name}: fpga_manager {manager.name} says {state!r} after the load")


class OverlayLoader:
    """An overlay with `firmware-name` on the region's fpga-region node: the kernel loads, then probes.

    The region's loading overlay is called ``cm-<region>``; the one before it is removed first, because
    a region refuses a second firmware overlay (Documentation/devicetree/bindings/fpga/fpga-region).
    """

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:  # noqa: ARG002 (the kernel has its own)
        if job.region is None or job.module is None:
            raise LoadFailed(f"{job.image.path.name}: a whole image is loaded by fpga_manager or icap, not by overlay")
        overlays = self._devices.overlays()
        name = loading_overlay(job.region.name)
        if name in overlays.list():
            overlays.remove(name)
        overlays.apply(name, self._files.loading_overlay(job.config, job.module))
        on_bytes(job.image.length)

    def forget(self) -> None:
        """Nothing is kept."""


def loading_overlay(region: str) -> str:
    """Name in configfs of the overlay by which a region's module was loaded."""
    return f"cm-{region}"


class Loaders:
    """One loader of each kind."""

    def __init__(self, devices: Devices, files: Files, clock: Clock, prefetch_bytes: int) -> None:
        self._icap = IcapLoader(devices, files, clock, prefetch_bytes)
        self._all: dict[LoaderKind, Loader] = {
            LoaderKind.ICAP: self._icap,
            LoaderKind.FPGA_MANAGER: FpgaManagerLoader(devices, files),
            LoaderKind.OVERLAY: OverlayLoader(devices, files),
        }

    def kind(self, kind: LoaderKind) -> Loader:
        """The loader of a kind."""
        return self._all[kind]

    def prefetch(self, job: Job) -> None:
        """Keep an image ready where its loader can."""
        if job.region is not None and job.region.loader is LoaderKind.ICAP:
            self._icap.prefetch(job)

    def forget(self) -> None:
        """The board was lost."""
        for loader in self._all.values():
            loader.forget()

# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: a small interface and its implementations, one per `LoaderKind`."""

from __future__ import annotations

import errno
import itertools
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from cm.bitstream.errors import WrongDevice
from cm.device import DeviceBusy, DeviceUnsupported, DmaBuffer, FpgaManager, Icap, IcapCompletion, IcapState
from cm.manager.errors import LoadFailed, StepTimeout
from cm.manager.ports import Clock, Devices, Files, Image
from cm.schema.model import Config, LoaderKind, Module, Region

_POLL = 0.05  # seconds between two looks at how far a load is; most loads are shorter, and none is slowed by a look

_PAGE = 4096
_REVISION = 0xF0000000  # bits of an IDCODE that differ between revisions of one device

OnBytes = Callable[[int], None]
_Key = tuple[str | None, str]


@dataclass(frozen=True, slots=True)
class Job:
    """An image and where it goes; region and module are None for the whole device."""

    config: Config
    image: Image
    region: Region | None = None
    module: Module | None = None
    overlay: bytes = b""  # by which the module is loaded, for LoaderKind.OVERLAY

    @property
    def port(self) -> str | None:
        """The name of the port, where there are several."""
        return self.region.loader_name if self.region else None


class Loader(Protocol):
    """Loads one image. Returns when the port is done; raises LoadFailed, StepTimeout or DeviceError."""

    def check(self, job: Job) -> None:
        """Raise what is known beforehand to stand against the job; touches nothing."""

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
    """DMA buffers that hold images for a port, least recently used out first, within a budget of bytes.

    A repeated change finds its image here and does no file I/O.
    """

    def __init__(self, budget: int, close: Callable[[Held], None]) -> None:
        self._budget = budget
        self._close = close
        self._held: OrderedDict[_Key, Held] = OrderedDict()

    def get(self, job: Job, icap: Icap, read: Callable[[Image], bytes]) -> tuple[Held, bool]:
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

    def prefetch(self, jobs: Sequence[Job], go_on: Callable[[], bool]) -> None:
        """Have these images' words, and no others, in DMA buffers: the first ones, as many as the budget holds."""
        self._cache.keep_only(jobs)
        for job in jobs:
            if not go_on():
                return
            if not self._cache.has(job) and self._cache.has_room(job.image.length):
                held, kept = self._cache.get(job, self._devices.icap(job.port), self._files.port_bytes)
                if not kept:
                    self._dispose(held)

    def check(self, job: Job) -> None:
        """The port knows its device: a bitstream for another one never reaches it."""
        there, wanted = self._devices.icap(job.port).info.idcode, job.image.report.idcode
        if there and wanted is not None and (there ^ wanted) & ~_REVISION:
            raise WrongDevice(
                f"{job.image.path}: made for IDCODE {wanted:#010x}, but the port is that of {there:#010x}"
            )

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:
        image = job.image
        icap = self._devices.icap(job.port)
        held, kept = self._cache.get(job, icap, self._files.port_bytes)
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

    def check(self, job: Job) -> None:
        """Mainline kernels have no attribute to load by; the image has to lie where the kernel looks."""
        manager: FpgaManager = self._devices.fpga_manager(job.port)
        if not manager.can_load:
            raise DeviceUnsupported(
                errno.EOPNOTSUPP,
                f"{job.image.path.name}: this kernel's fpga_manager cannot load through sysfs (linux-xlnx can); "
                "use loader: overlay with firmware-name, or loader: icap",
            )
        self._files.firmware_name(job.image)

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

    def __init__(self, devices: Devices) -> None:
        self._devices = devices

    def check(self, job: Job) -> None:
        """A whole image cannot be loaded so: the node of its region would go with it."""
        _region_of(job)

    def load(self, job: Job, timeout: float, on_bytes: OnBytes) -> None:  # noqa: ARG002 (the kernel has its own)
        overlays = self._devices.overlays()
        name = loading_overlay(_region_of(job).name)
        if name in overlays.list():  # left over from an earlier run
            overlays.remove(name)
        overlays.apply(name, job.overlay)
        on_bytes(job.image.length)

    def forget(self) -> None:
        """Nothing is kept."""


def _region_of(job: Job) -> Region:
    if job.region is None:
        raise LoadFailed(f"{job.image.path.name}: a whole image is loaded by fpga_manager or icap, not by overlay")
    return job.region


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
            LoaderKind.OVERLAY: OverlayLoader(devices),
        }

    def kind(self, kind: LoaderKind) -> Loader:
        """The loader of a kind."""
        return self._all[kind]

    def prefetch(self, jobs: Iterable[Job], go_on: Callable[[], bool] = lambda: True) -> None:
        """Keep these images ready where their loader can, and no others; asks `go_on` before each."""
        self._icap.prefetch([j for j in jobs if j.region and j.region.loader is LoaderKind.ICAP], go_on)

    def forget(self) -> None:
        """The board was lost."""
        for loader in self._all.values():
            loader.forget()

# SPDX-License-Identifier: Apache-2.0
"""How an image reaches the device: which port, and a loader for each kind of one."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol
from weakref import WeakKeyDictionary

from cm.errors import Busy, CmError
from cm.frozen import dataclass, replace
from cm.manager.errors import LoadFailed, LoadUnsupported, NoPort, StepTimeout, WrongDevice
from cm.manager.inputs import Image
from cm.manager.state.board_state import loading_overlay
from cm.manager.state.steps import Choice
from cm.schema.model import Config, LoaderKind, Region

if TYPE_CHECKING:
    from cm.manager.interfaces import (
        ConfigPort,
        Devices,
        Files,
        KernelLoader,
        OverlayFolder,
        PortBuffer,
        PortCompletion,
        PortInfo,
        TimeSource,
    )

    _Key = tuple[ConfigPort, str]  # an open port, whose a buffer is: it may go, and come back as another; and a hash

OnBytes = Callable[[int], None]
Start = Callable[[OnBytes], None]  # loads, telling how far it is; returns when the port is done


@dataclass(frozen=True, slots=True)
class Job:
    """An image and where it goes; the region is None for the whole device."""

    image: Image
    region: Region | None = None
    overlay: bytes = b""  # by which a module is loaded, for LoaderKind.OVERLAY
    port: str | None = None  # its name, where there are several


class Loader(Protocol):
    """Loads one image."""

    def check(self, job: Job) -> None:
        """Raise what is known beforehand to prevent the job; touches nothing."""

    def prepared(self, job: Job, timeout: float) -> AbstractContextManager[Start]:
        """On entry, all that can be done before the port is touched; gives the function that touches it.

        `timeout` (seconds) is for both. Entering raises what is wrong with files or memory, or StepTimeout if the port
        stays busy: then nothing was loaded. `Start` raises LoadFailed, StepTimeout or DeviceError.
        """


_POLL = 0.1  # seconds between two looks at a load's progress; most loads are shorter, and looking slows none
_REVISION = 0xF0000000  # bits of an IDCODE that differ between revisions of one device
_PAGE = 4096


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
        key, image = (icap, job.image.sha256), job.image
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

    def keep_only(self, wanted: Collection[_Key]) -> None:
        """Close all other buffers."""
        for key in [k for k in self._held if k not in wanted]:
            self._close(self._held.pop(key))

    def has(self, key: _Key) -> bool:
        """Whether a port's image is here."""
        return key in self._held

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


def _filled(icap: ConfigPort, data: bytes) -> Held:
    buffer = icap.allocate(len(data))
    try:
        buffer.sync_begin(write=True)
        buffer.memoryview()[: len(data)] = data
        buffer.sync_end(write=True)
        buffer.unmap()  # the port reads it, we do not: a manager keeps many images
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
        self.prefetched: Config | None = None  # whose images are here, until a load has had to read its own
        self._told: WeakKeyDictionary[ConfigPort, PortInfo] = WeakKeyDictionary()  # by open ports, each asked once
        self._in_use: list[Held] = []
        self._cookies = itertools.count(1)

    def prefetch(self, jobs: Sequence[Job], go_on: Callable[[], bool]) -> None:
        """Keep only these images' words in DMA buffers: the first ones, as many as fit in the budget."""
        ported = [(job, self._devices.icap(job.port)) for job in jobs]
        self._cache.keep_only({(icap, job.image.sha256) for job, icap in ported})
        for job, icap in ported:
            if not go_on():
                return
            if not self._cache.has((icap, job.image.sha256)) and self._cache.has_room(job.image.length):
                held, kept = self._cache.get(job, icap, self._files.port_bytes)
                if not kept:
                    self._dispose(held)

    def check(self, job: Job) -> None:
        """The port is asked, once: whether it may be used, and for its device: no other's bitstream reaches it."""
        port = self._devices.icap(job.port)
        info = self._told.get(port) or self._told.setdefault(port, port.info)
        if info.denied:
            raise LoadFailed(
                f"{job.image.path.name}: the platform's firmware does not let the ICAP be selected; allow "
                "0xFFCA3008 in its pm_mmio_access.c, or write loader: auto or fpga_manager"
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
        if not self._cache.has((icap, job.image.sha256)):
            self.prefetched = None
        held, kept = self._cache.get(job, icap, self._files.port_bytes)
        try:
            self._await_idle(icap, job.image, timeout)
            yield lambda on_bytes: self._load(icap, held, job.image, timeout, on_bytes, whole=job.region is None)
        finally:
            if not kept:
                self._dispose(held)

    def _load(
        self, icap: ConfigPort, held: Held, image: Image, timeout: float, on_bytes: OnBytes, whole: bool = False
    ) -> None:
        cookie = next(self._cookies)
        icap.load(held.buffer, held.length, cookie=cookie, full=whole, encrypted=image.encrypted)
        completion = self._wait(icap, cookie, image, timeout, on_bytes)
        if completion.status != 0:
            raise LoadFailed(f"{image.path.name}: the configuration port reported: {completion.reason}")

    def write(self, port: str | None, words: bytes, image: Image, timeout: float) -> None:
        """Load words that are no image of a file. Raises LoadFailed, StepTimeout or DeviceError."""
        icap = self._devices.icap(port)
        held = _filled(icap, words)
        try:
            self._await_idle(icap, image, timeout)
            self._load(icap, held, image, timeout, lambda _: None)
        finally:
            self._dispose(held)

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
        """Give all buffers back."""
        self.prefetched = None
        self._cache.clear()


class FpgaManagerLoader:
    """The kernel's fpga_manager, by firmware name (linux-xlnx). Blocks until the kernel is done."""

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def check(self, job: Job) -> None:
        """Mainline kernels have no attribute to load by; the image has to lie where the kernel looks."""
        manager: KernelLoader = self._devices.fpga_manager(job.port)
        if not manager.can_load:
            raise LoadUnsupported(
                f"{job.image.path.name}: this kernel's fpga_manager cannot load through sysfs (linux-xlnx can); "
                "use loader: overlay with firmware-name, or loader: icap",
            )
        self._files.firmware_name(job.image)

    @contextmanager
    def prepared(self, job: Job, timeout: float) -> Iterator[Start]:  # noqa: ARG002 (the kernel has its own)
        """The image where the kernel looks for it."""
        manager: KernelLoader = self._devices.fpga_manager(job.port)
        name = self._files.firmware_name(job.image)
        yield lambda on_bytes: self._load(manager, name, job, on_bytes)

    def _load(self, manager: KernelLoader, name: str, job: Job, on_bytes: OnBytes) -> None:
        """The kernel reads the file itself: if it was replaced meanwhile, that may be what was loaded."""
        manager.load(name, partial=job.region is not None, encrypted=job.image.encrypted)
        state = manager.state
        if state != "operating":
            raise LoadFailed(f"{job.image.path.name}: fpga_manager {manager.name} says {state!r} after the load")
        self._files.check_firmware(name, job.image)
        on_bytes(job.image.length)


class OverlayLoader:
    """An overlay with `firmware-name` on the region's fpga-region node: the kernel loads, then probes.

    The region's loading overlay is called ``cm-<region>``; the one before it is removed first, because
    a region refuses a second firmware overlay (Documentation/devicetree/bindings/fpga/fpga-region).
    """

    def __init__(self, devices: Devices, files: Files) -> None:
        self._devices = devices
        self._files = files

    def check(self, job: Job) -> None:
        """A full image cannot be loaded this way: the node of its region would go with it."""
        _region_of(job)
        self._files.firmware_name(job.image)

    @contextmanager
    def prepared(self, job: Job, timeout: float) -> Iterator[Start]:  # noqa: ARG002 (the kernel has its own)
        """The region's node without an overlay that an earlier run left."""
        firmware = self._files.firmware_name(job.image)
        overlays = self._devices.overlays()
        name = loading_overlay(_region_of(job).name)
        if overlays.has(name):
            overlays.remove(name)
        yield lambda on_bytes: self._load(overlays, name, firmware, job, on_bytes)

    def _load(self, overlays: OverlayFolder, name: str, firmware: str, job: Job, on_bytes: OnBytes) -> None:
        """The kernel reads our copy itself: if another process has written to it, that may be what was loaded."""
        overlays.apply(name, job.overlay)
        self._files.check_firmware(firmware, job.image)
        on_bytes(job.image.length)


def _region_of(job: Job) -> Region:
    if job.region is None:
        raise LoadFailed(f"{job.image.path.name}: a whole image is loaded by fpga_manager or icap, not by overlay")
    return job.region


class Loaders:
    """One loader of each kind."""

    def __init__(self, devices: Devices, files: Files, time: TimeSource, prefetch_bytes: int) -> None:
        self._files, self._devices = files, devices
        self._icap = IcapLoader(devices, files, time, prefetch_bytes)
        self._prefetches = prefetch_bytes > 0
        self._all: dict[LoaderKind, Loader] = {
            LoaderKind.ICAP: self._icap,
            LoaderKind.FPGA_MANAGER: FpgaManagerLoader(devices, files),
            LoaderKind.OVERLAY: OverlayLoader(devices, files),
        }

    def kind(self, kind: LoaderKind) -> Loader:
        """The loader of a kind."""
        return self._all[kind]

    def write(self, region: Region, words: bytes, image: Image, timeout: float) -> None:
        """Load words that are no image of a file into a region, through its ICAP; `image` is what is there."""
        self._icap.write(region.loader_name, words, image, timeout)

    def instead(self, job: Job, schema: Config, refused: Exception) -> tuple[Loader, Job, Choice]:
        """The loader after the ICAP has refused a job, and what it is given, if the schema leaves the port open.

        Else raises `refused`.
        """
        region = schema.regions.get(job.region.name) if job.region else None
        chosen = job.region.loader if job.region else None
        left_open = region is not None and region.loader is LoaderKind.AUTO and chosen is LoaderKind.ICAP
        if not left_open or _against_fpga_manager(None, self._devices):
            raise refused
        other, job = self._all[LoaderKind.FPGA_MANAGER], replace(job, port=None)  # its name is an ICAP's
        other.check(job)
        return other, job, Choice(LoaderKind.FPGA_MANAGER, f"icap: {refused}")

    def prefetch(self, jobs: Iterable[Job], go_on: Callable[[], bool] = lambda: True) -> None:
        """Keep only these images ready, if their loader can; asks `go_on` before each."""
        self._icap.prefetch([j for j in jobs if j.region and j.region.loader is LoaderKind.ICAP], go_on)

    def prefetch_modules(self, config: Config | None, go_on: Callable[[], bool]) -> None:
        """The same for the images of a configuration's modules. Errors in one are reported when it is used.

        Nothing is looked for while loads find their images there: a file that was replaced is read by the first load.
        """
        if not self._prefetches or config is None or config is self._icap.prefetched or not go_on():
            return
        jobs = list(self._jobs(resolved(config, (), self._devices)[0], go_on))
        if go_on():
            with contextlib.suppress(CmError, OSError):
                self.prefetch(jobs, go_on)
        if go_on():
            self._icap.prefetched = config

    def _jobs(self, config: Config, go_on: Callable[[], bool]) -> Iterator[Job]:
        for module in config.modules.values():
            if not go_on():
                return
            with contextlib.suppress(CmError, OSError):
                region = config.regions[module.region]
                yield Job(self._files.image(config, module), region, port=region.loader_name)

    def forget(self) -> None:
        """The board was lost: drop what belongs to it."""
        self._icap.forget()


def resolved(config: Config, wanted: Collection[str], devices: Devices) -> tuple[Config, Mapping[str, Choice]]:
    """The configuration with a port for each region of `loader: auto`, and the choices by region.

    Raises NoPort if a region in `wanted` cannot be loaded; for the others this is reported when they are needed.
    """
    open_ = [region for region in config.regions.values() if region.loader is LoaderKind.AUTO]
    choices = {region.name: _choose(region, region.name in wanted, devices) for region in open_}
    if not choices:
        return config, MappingProxyType({})
    regions = {name: _by(choices[name].kind, r) if name in choices else r for name, r in config.regions.items()}
    return replace(config, regions=MappingProxyType(regions)), MappingProxyType(choices)


def _by(kind: LoaderKind, region: Region) -> Region:
    """A region with its port chosen; the name of an ICAP is none of an fpga_manager."""
    name = _fpga(region) if kind is LoaderKind.FPGA_MANAGER else region.loader_name
    return replace(region, loader=kind, loader_name=name)


def _fpga(region: Region) -> str | None:
    name = region.loader_name
    return name if name is not None and name.startswith("fpga") else None


def _choose(region: Region, wanted: bool, devices: Devices) -> Choice:
    """The ICAP is the faster one, and loads by it need no file where the kernel looks."""
    reasons: list[str] = []
    for kind, refusal in _ports(region, devices):
        if not refusal:
            return Choice(kind, "; ".join(reasons))
        reasons.append(f"{kind.value}: {refusal}")
    if wanted:
        raise NoPort(
            f"region {region.name} (loader: auto) cannot be loaded. {'; '.join(reasons)}. Mainline kernels load by "
            "overlays with firmware-name: loader: overlay"
        )
    return Choice(LoaderKind.ICAP, "; ".join(reasons))


def _ports(region: Region, devices: Devices) -> Iterator[tuple[LoaderKind, str]]:
    """The ports in their order, each with what prevents its use."""
    yield LoaderKind.ICAP, _against_icap(region, devices)
    yield LoaderKind.FPGA_MANAGER, _against_fpga_manager(_fpga(region), devices)


def _against_icap(region: Region, devices: Devices) -> str:
    if name := _fpga(region):
        return f"the schema names {name}"
    try:
        info = devices.icap(region.loader_name).info
    except (CmError, OSError) as error:
        return str(error)
    return "the platform's firmware does not let it be selected" if info.denied else ""


def _against_fpga_manager(name: str | None, devices: Devices) -> str:
    try:
        can_load = devices.fpga_manager(name).can_load
        return "" if can_load else "this kernel's fpga_manager has no firmware attribute (linux-xlnx has)"
    except (CmError, OSError) as error:
        return str(error)

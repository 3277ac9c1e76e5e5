# SPDX-License-Identifier: Apache-2.0
"""The files of a configuration: found, read, validated once per content, and copied for the kernel.

The kernel opens bitstreams itself, by name, after they were checked here. So we search where the kernel does
(drivers/base/firmware_loader/main.c: `fw_path`), and give it only our own copies, each named by the hash of what was
validated, and compared before and after. Overlays are checked for what they would make the kernel load.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from cm.device import Root
from cm.device.overlays import FOLDER as OVERLAY_FOLDER
from cm.errors import CmError, InvalidRequest
from cm.formats import fdt
from cm.formats.bitstream import (
    Container,
    Expectation,
    Report,
    ReportCache,
    convert,
    expect_module,
    expect_static,
    footprint_of,
    to_dma_words,
    verify,
)
from cm.formats.bitstream.errors import BadContainer, BitstreamError, Sha256Mismatch
from cm.formats.bitstream.report_cache import Inspected
from cm.formats.fdt_overlay import targets
from cm.frozen import dataclass
from cm.manager.errors import BadOverlay
from cm.manager.inputs import Image
from cm.schema.model import Config, FrameRange, LoaderKind, Module, Overlay, Region
from cm.schema.named_files import FileMissing, bitstream_path, find_file, firmware_spellings, overlay_path
from cm.server.durable_files import write
from cm.server.private_folders import own_folder
from cm.wire.messages.status import RegionColumn

if TYPE_CHECKING:
    from cm.manager.interfaces import LoadedFrames

MAX_BYTES = 512 << 20  # more than the largest device of the supported families needs

_KEPT = 256  # files
_FRAMES_KEPT = 4  # images whose frames are ready to be compared

_Pair = tuple[str, str]
_SYNC = b"\x66\x55\x99\xaa"
_PADDING = (b"\x00\x00\x00\x20", bytes(4), b"\xff\xff\xff\xff")  # NOP; what fills up a file; dummy words


class BitstreamReader:
    """Used by the worker and by plans that are made beside it, so the cache has a lock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache = ReportCache()
        self._good: dict[tuple[Path, Expectation], Report] = {}  # of files that were as expected when last compared
        self._same: set[_Pair] = set()  # file and image with the same words, by their hashes
        self._alike: set[_Pair] = set()  # file and image that differ in padding at most

    def image(self, path: Path, expect: Expectation) -> Image:
        """A file that is as expected, as the manager has it. Raises the refusals of `cm.formats.bitstream`."""
        found = self.validated(path, expect)
        return Image(path, found.sha256, found.length, found.idcode, found.partial, found.encrypted)

    def validated(self, path: Path, expect: Expectation) -> Report:
        """The report of a file that is as expected. Raises the refusals of `cm.formats.bitstream`."""
        report = self.inspect(path)
        if self._good.get((path, expect)) is report:
            return report
        try:
            verify(report, expect)
        except BitstreamError as error:
            raise type(error)(f"{path}: {error}") from error
        if len(self._good) >= _KEPT:
            self._good.clear()
        self._good[path, expect] = report
        return report

    def inspect(self, path: Path) -> Report:
        """The report of a file, from the cache if it is still the same file."""
        with self._lock:
            known = self._cache.known(path)
        if known is not None:
            return known
        _check_size(path)
        with self._lock:
            return self._cache.inspect(path)

    def read(self, image: Image) -> bytes:
        """The bytes that were validated. Raises Sha256Mismatch if the file has changed."""
        found = self._read(image.path)
        if found.report.sha256 != image.sha256:
            raise Sha256Mismatch(f"{image.path}: the file was replaced after it had been checked; ask again")
        return found.data

    def has_words_of(self, path: Path, image: Image) -> bool:
        """Whether a file, in whatever container, holds the words that were validated.

        Raises OSError, and the refusals of `cm.formats.bitstream` if it is not a bitstream.
        """
        return self._compared(path, image, self._same, bytes)

    def configures_as(self, path: Path, image: Image) -> bool:
        """Whether a file, in whatever container, configures the device as the image does.

        Vivado's .bin has one NOP more than its .bit, bootgen's has other padding. Raises as `has_words_of`.
        """
        return self._compared(path, image, self._alike, _effective)

    def _compared(self, path: Path, image: Image, known: set[_Pair], part: Callable[[bytes], bytes]) -> bool:
        there = self.inspect(path).sha256
        if there == image.sha256 or (there, image.sha256) in known:
            return True
        if path == image.path:
            return False
        found = self._read(path)  # once: a second look may find another file
        if part(to_dma_words(found.data)) != part(to_dma_words(self.read(image))):
            return False
        known.add((found.report.sha256, image.sha256))
        return True

    def _read(self, path: Path) -> Inspected:
        _check_size(path)
        with self._lock:
            return self._cache.read(path)


def _effective(words: bytes) -> bytes:
    """A stream in memory order from its sync word on, without the padding behind it."""
    start, end = max(0, words.find(_SYNC)), len(words)
    while end - start >= 4 and words[end - 4 : end] in _PADDING:
        end -= 4
    return words[start:end]


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise BadContainer(f"{path}: {size} bytes are not a bitstream; at most {MAX_BYTES >> 20} MiB are read")


_FIRMWARE = Path("lib/firmware")
_OVERLAYS = Path(OVERLAY_FOLDER)
_CUSTOM = Path("sys/module/firmware_class/parameters/path")
_CONVERTED = "cm-converted"
_OURS = re.compile(r"[0-9a-f]{64}\.bin")
_COPIES = 64


class FirmwareFolder:
    """The firmware below a root.

    Converted files lie in the folder that the kernel was given (firmware_class.path), which a system with a read-only
    root has on a tmpfs or a data partition, or else in ``/lib/firmware``.
    """

    def __init__(self, root: Path, reader: BitstreamReader) -> None:
        self._root = root
        self.folder = root / _FIRMWARE
        self._reader = reader

    def place(self, name: str) -> Path:
        """The file that the kernel opens for a name. Raises InvalidRequest for one that leaves the folder."""
        parts = PurePosixPath(name)
        if not name or parts.is_absolute() or ".." in parts.parts:
            raise InvalidRequest(f"firmware name {name!r}: a path below /lib/firmware is expected")
        places = [folder / name for folder in self._searched()]
        return next((place for place in places if place.exists()), places[-1])

    def _searched(self) -> Iterator[Path]:
        custom = self._custom()
        if custom is not None:
            yield custom
        release = os.uname().release
        yield from (self.folder / "updates" / release, self.folder / "updates", self.folder / release)
        yield self.folder

    def private_name(self, image: Image) -> str:
        """The name of our own copy of an image, whether or not it is there yet."""
        return f"{_CONVERTED}/{image.sha256}.bin"

    def _custom(self) -> Path | None:
        """The folder that the kernel searches first, if it was given one.

        sysfs shows the value and ends it with a newline. One more is the value's own, as `echo` writes it: 6.1 looks in
        a folder whose name ends so, 6.12 does not. As no kernel is asked which it does, it is no folder of either.
        """
        with contextlib.suppress(OSError, UnicodeDecodeError):
            custom = (self._root / _CUSTOM).read_text(encoding="utf-8").removesuffix("\n")
            if custom and not custom.endswith("\n"):
                return self._root / custom.lstrip("/")
        return None

    def name_of(self, image: Image) -> str:
        """A name under which the kernel finds the image as a word-swapped .bin: always our own copy of it.

        Others may write to the file that was validated, between the check and the kernel's reading it.
        Raises Sha256Mismatch if that file changed since and the copy has to be made yet.
        """
        self._copy(image)
        name = self.private_name(image)
        self.check(name, image)
        return name

    def check(self, name: str, image: Image) -> None:
        """Raise Sha256Mismatch if the kernel would find other words under the name than were validated."""
        place = self.place(name)
        try:
            same = self._reader.has_words_of(place, image)
        except BitstreamError as error:
            raise Sha256Mismatch(f"{place}: {error}; the kernel would load it for {image.path}") from error
        if not same:
            raise Sha256Mismatch(f"{place}: not the bitstream that was checked as {image.path}; ask again")

    def _copy(self, image: Image) -> None:
        """Make sure of a copy under the hash of what was validated; a damaged one is made again."""
        custom = self._custom()
        base = custom if custom is not None and os.access(custom, os.W_OK) else self.folder
        folder = base / _CONVERTED
        own_folder(folder, mode=0o755)  # the kernel reads from there, so no other user may write
        target = base / self.private_name(image)
        good = False
        with contextlib.suppress(BitstreamError, FileNotFoundError):
            good = not target.is_symlink() and self._reader.has_words_of(target, image)
        if not good:
            _write(target, convert(self._reader.read(image), Container.BIN_SWAPPED))
        _prune(folder, target)


def _write(target: Path, data: bytes) -> None:
    """Write whole or not at all, even at a loss of power; in a folder where nobody else could put a link."""
    new = target.with_name(f".{target.stem}.new")
    try:
        write(new, data, 0o644)
        new.replace(target)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _prune(folder: Path, used: Path) -> None:
    """Keep the most recently used copies: others are made again when needed.

    File times are only compared with each other, since a board without a clock begins in 1970.
    """
    others = [path for path in folder.iterdir() if _OURS.fullmatch(path.name) and path != used]
    ages = {path: path.lstat().st_mtime_ns for path in others}
    newest = max(ages.values(), default=0) + 1
    if used.stat().st_mtime_ns < newest:
        os.utime(used, ns=(newest, newest))
    for old in sorted(others, key=ages.__getitem__, reverse=True)[_COPIES - 1 :]:
        old.unlink(missing_ok=True)
    for half in folder.glob(".*.new"):  # of a run that was killed
        half.unlink(missing_ok=True)


_NAME = "firmware-name"
_PARTIAL, _ENCRYPTED, _EXTERNAL = "partial-fpga-config", "encrypted-fpga-config", "external-fpga-config"
_KNOWN = (_PARTIAL, _ENCRYPTED, _EXTERNAL)
_DMABUF = "fpga-config-from-dmabuf"  # of linux-xlnx: it names no file that could be checked
_LOADING = frozenset({_NAME, _PARTIAL, _ENCRYPTED})
_UNRESOLVED = b"\xff\xff\xff\xff"  # where dtc leaves a phandle to __fixups__


@dataclass(frozen=True, slots=True)
class FirmwareLoad:
    """What an overlay would make the kernel load: a name below /lib/firmware, and what it says of the image."""

    name: str
    partial: bool
    encrypted: bool


def checked_overlay(name: str, blob: bytes) -> bytes:
    """The blob, if it is a whole device tree with an ``__overlay__`` node, and each fragment knows what it changes.

    Raises BadOverlay.
    """
    root = _read(name, blob).root
    if not any(_targets(root)):
        raise BadOverlay(f"{name}: no fragment has an __overlay__ node; compile an overlay (/plugin/;) with dtc")
    known = targets(root)
    for fragment in root.children:
        lost = fragment.properties.get("target", _UNRESOLVED) == _UNRESOLVED and fragment.name not in known
        if lost and fragment.child("__overlay__"):
            raise BadOverlay(
                f"{name}: {fragment.name} has no target: __fixups__ names no label for it; a tool that wrote this "
                "overlay has dropped that node, so compile its source with dtc -@"
            )
    return blob


def firmware_loads(name: str, blob: bytes) -> tuple[FirmwareLoad, ...]:
    """Everything that applying an overlay would load. Raises BadOverlay, also if that cannot be known beforehand."""
    root = _read(name, blob).root
    for _, node in root.walk():
        is_region = b"fpga-region" in node.properties.get("compatible", b"").split(b"\0")
        if _NAME in node.properties and node.name != "__overlay__" and is_region:
            raise BadOverlay(
                f"{name}: node {node.name} adds an fpga-region with {_NAME}, which the kernel refuses: "
                "a region is loaded once it exists, by an overlay that targets it"
            )
    loads = []
    for node in _targets(root):
        if _DMABUF in node.properties:
            raise BadOverlay(f"{name}: {_DMABUF} would load what cannot be checked first; name a file ({_NAME})")
        if _NAME in node.properties:
            loads.append(_load(name, node))
    return tuple(loads)


def naming(name: str, blob: bytes, firmware: str) -> bytes:
    """A copy of the overlay whose every ``firmware-name`` is `firmware`."""
    value = firmware.encode() + b"\0"
    return _changed(name, blob, lambda node: {k: value if k == _NAME else v for k, v in node.properties.items()})


def loading_nothing(name: str, blob: bytes) -> bytes:
    """A copy of the overlay that adds the same nodes, to a device that is configured already."""

    def kept(node: fdt.FdtNode) -> dict[str, bytes]:
        return {k: v for k, v in node.properties.items() if k not in _LOADING}

    return _changed(name, blob, kept)


def _changed(name: str, blob: bytes, properties: Callable[[fdt.FdtNode], dict[str, bytes]]) -> bytes:
    tree = _read(name, blob)
    for node in _targets(tree.root):
        node.properties = properties(node)
    return fdt.write(tree)


def _read(name: str, blob: bytes) -> fdt.Fdt:
    try:
        return fdt.read(blob)
    except fdt.FdtError as error:
        raise BadOverlay(f"{name}: not a whole device-tree blob ({error}); compile it with dtc") from error


def _targets(root: fdt.FdtNode) -> Iterator[fdt.FdtNode]:
    return (node for _, node in root.walk() if node.name == "__overlay__")


def _load(name: str, node: fdt.FdtNode) -> FirmwareLoad:
    if _EXTERNAL in node.properties:
        raise BadOverlay(f"{name}: {_NAME} and {_EXTERNAL} in one node contradict each other; the kernel refuses them")
    for key in node.properties:  # others make linux-xlnx treat the image differently: user keys, authentication
        if (key.endswith("-fpga-config") or key == "encrypted-key-name") and key not in _KNOWN:
            raise BadOverlay(
                f"{name}: {key} asks for a way of loading that is not supported; supported is {', '.join(_KNOWN)}"
            )
    value = node.properties[_NAME]
    if not value.endswith(b"\0") or value.count(b"\0") != 1 or len(value) < 2:
        raise BadOverlay(f"{name}: its {_NAME} {value!r} is not one name")
    return FirmwareLoad(
        value[:-1].decode("utf-8", "replace"), _PARTIAL in node.properties, _ENCRYPTED in node.properties
    )


_MAX_OVERLAY = 16 << 20  # bytes
_Overlay = tuple[bytes, tuple[FirmwareLoad, ...], Mapping[str, bool]]  # a checked blob; loads; targets: of a load?


class OverlayFiles:
    """The .dtbo files below a root."""

    def __init__(self, root: Path, reader: BitstreamReader, firmware: FirmwareFolder) -> None:
        self._root = root
        self._reader = reader
        self._firmware = firmware
        self._checked: dict[Path, tuple[tuple[object, ...], _Overlay]] = {}

    def beside(self, config: Config, overlay: Overlay, images: Sequence[Image]) -> bytes:
        """An overlay that comes with a configuration or mode whose `images` are in the device when it is applied.

        If it names them, they are not loaded a second time: a full image would erase what was loaded into its regions
        since. Raises FileMissing, and BadOverlay if it would load anything else, or stands on the node of a region that
        is loaded by overlay.
        """
        path = overlay_path(config, overlay, self._root)
        data, loads, aims = self._overlay(path)
        self._check_regions_free(path, config, aims)
        for load in loads:
            self._known(path, config, load, images)
        return loading_nothing(str(path), data) if loads else data

    def loading(self, config: Config, module: Module, image: Image) -> bytes:
        """The overlay by which a module is loaded, naming our own copy of its image.

        Raises FileMissing, and BadOverlay if it names anything but that image, or is not an overlay for it.
        """
        path = find_file(config, [f"{module.name}.dtbo"], self._root)
        data, loads, _ = self._overlay(path)
        if len(loads) != 1:
            raise BadOverlay(f"{path}: one firmware-name is expected, there are {len(loads)}")
        self._known(path, config, loads[0], [image])
        return naming(str(path), data, self._firmware.private_name(image))

    def _check_regions_free(self, path: Path, config: Config, aims: Collection[str]) -> None:
        """The kernel refuses whatever else is put on a region with a firmware overlay; and to take the refused one off
        again opens the region's bridges (drivers/fpga/of-fpga-region.c)."""
        for module in config.modules.values():
            if config.regions[module.region].loader is not LoaderKind.OVERLAY:
                continue
            try:
                loading = find_file(config, [f"{module.name}.dtbo"], self._root)
            except FileMissing:
                continue  # said where the module is to be loaded
            if shared := [aim for aim, loads in self._overlay(loading)[2].items() if loads and aim in aims]:
                raise BadOverlay(
                    f"{path}: it changes {', '.join(sorted(shared))}, to which {loading.name} loads {module.name} by "
                    f"overlay; the kernel takes no other overlay there: put its nodes into {loading.name}"
                )

    def _overlay(self, path: Path) -> _Overlay:
        """What was found in a file is kept for as long as the file is the same: a tree takes long to read."""
        state = path.stat()
        key = (path, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        found = self._checked.get(path)
        if found is not None and found[0] == key:
            return found[1]
        if state.st_size > _MAX_OVERLAY:
            raise BadOverlay(
                f"{path}: {state.st_size} bytes are not an overlay; it has at most {_MAX_OVERLAY >> 20} MiB"
            )
        data = checked_overlay(str(path), path.read_bytes())
        root = fdt.unpack(data)
        contents = {fragment.name: fragment.child("__overlay__") for fragment in root.children}
        loading = {name for name, node in contents.items() if node is not None and _NAME in node.properties}
        aims = {target: fragment in loading for fragment, target in targets(root).items()}
        found = self._checked[path] = key, (data, firmware_loads(str(path), data), aims)
        return found[1]

    def _known(self, path: Path, config: Config, load: FirmwareLoad, images: Sequence[Image]) -> None:
        """Raise BadOverlay unless a firmware-name leads to one of the images, with the right flags for it."""
        what = f"{path}: its firmware-name {load.name!r}"
        try:
            place = self._place(path, config, load.name)
            image = next((image for image in images if self._reader.configures_as(place, image)), None)
        except (CmError, OSError) as error:
            raise BadOverlay(f"{what} cannot be used ({error})") from error
        if image is None:
            known = f"the plan knows {', '.join(str(image.path) for image in images)}"
            if not images:
                known = (
                    "the plan loads nothing of that kind: list it as a module, or as the bitstream of a full "
                    "configuration"
                )
            raise BadOverlay(f"{what} is {self._described(place)}; {known}")
        _check_flags(what, load, image)

    def _place(self, path: Path, config: Config, name: str) -> Path:
        """The file that a name means: the package's own comes before those in the kernel's folders."""
        by_kernel = self._firmware.place(name)  # refuses names that leave the folder
        own = list(dict.fromkeys((path.parent, path.resolve().parent)))  # of an import, the overlay is a link
        places = [folder / name for folder in own]
        places += [self._firmware.folder / "cm" / config.name / name, by_kernel]
        places += [folder / other for folder in own for other in firmware_spellings(name)]
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            raise BadOverlay(f"there is no such file; looked for {', '.join(map(str, dict.fromkeys(places)))}")
        return found

    def _described(self, place: Path) -> str:
        report = self._reader.inspect(place)
        kind = "partial" if report.partial else "whole"
        why = f", which must not be loaded: {report.problems[0].message}" if report.problems else ""
        return f"another bitstream, {place} ({kind}, {report.design or report.device or 'of no known device'}){why}"


def _check_flags(what: str, load: FirmwareLoad, image: Image) -> None:
    partial, encrypted = image.partial, image.encrypted
    if load.partial != partial:
        kinds = ("whole image", "partial one")
        raise BadOverlay(
            f"{what} is a {kinds[partial]} and would be loaded as a {kinds[not partial]}: "
            f"{'add' if partial else 'remove'} partial-fpga-config"
        )
    if load.encrypted != encrypted:
        raise BadOverlay(
            f"{what} is {'' if encrypted else 'not '}encrypted: "
            f"{'add' if encrypted else 'remove'} encrypted-fpga-config"
        )


_KEYS = {"footprint_outside": "region's key footprint", "encrypted": "region's key allow_encrypted"}


class BoardFiles:
    """`cm.manager.interfaces.Files` over the file system below a root."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._reader = BitstreamReader()
        self._firmware = FirmwareFolder(root, self._reader)
        self._footprints: dict[str, tuple[FrameRange, ...]] = {}  # that modules show, by their hashes
        self._frames: dict[str, LoadedFrames] = {}  # by the image's hash
        overlays = OverlayFiles(root, self._reader, self._firmware)
        self.firmware_name, self.check_firmware = self._firmware.name_of, self._firmware.check
        self.overlay, self.loading_overlay = overlays.beside, overlays.loading

    # ---- bitstreams -----------------------------------------------------------------

    def image(self, config: Config, module: Module) -> Image:
        """Find and validate a module's bitstream.

        Raises FileMissing and the refusals of `cm.formats.bitstream`. The footprint allowed is the schema's, or
        that of the first good module of the region, as the schema lists them.
        """
        region = config.regions[module.region]
        expect = expect_module(config, module, () if region.footprint else self._shown(config, region))
        path = bitstream_path(config, module, self._root)
        try:
            return self._reader.image(path, expect)
        except BitstreamError as refused:  # named are the file, whose it is, and the key that mends it
            key = _KEYS.get(refused.code, "module's key bitstream")
            why = str(refused).removeprefix(f"{path}: ")
            whose = f"module {module.name} of region {module.region} in {config.name}"
            raise type(refused)(f"{path}, of {whose}: {why} (build it again, or see the {key})") from refused

    def _shown(self, config: Config, region: Region) -> tuple[FrameRange, ...]:
        """What the region's modules show it to own; empty if none of their bitstreams is good."""
        for module in config.modules.values():
            if module.region == region.name:
                with contextlib.suppress(CmError, OSError):
                    path = bitstream_path(config, module, self._root)
                    report = self._reader.validated(path, expect_module(config, module))
                    if report.sha256 not in self._footprints:
                        self._footprints[report.sha256] = footprint_of(report)
                    if shown := self._footprints[report.sha256]:
                        return shown
        return ()

    def static_image(self, config: Config) -> Image:
        """Find and validate the image of a full configuration."""
        path = bitstream_path(config, None, self._root)
        return self._reader.image(path, expect_static(config))

    def port_bytes(self, image: Image) -> bytes:
        """Words in the order a DMA-fed port takes them. Raises Sha256Mismatch if the file changed since."""
        return to_dma_words(self._reader.read(image))

    def columns(self, image: Image) -> tuple[str, list[RegionColumn]]:
        """For whoever wants to see them: no start waits for these modules."""
        from cm.formats.bitstream.memory import frames_in
        from cm.formats.xray.fabric import fabric

        device, frames = frames_in(self._reader.read(image))
        return device.name, [RegionColumn(c.address, c.bits, c.switches, c.logic, c.clock) for c in fabric(frames)]

    def loaded_frames(self, image: Image) -> LoadedFrames:
        """What an image leaves in the device. Those of the last few are kept: scrubbing asks again and again."""
        from cm.formats.bitstream.container import open_image
        from cm.formats.bitstream.errors import UnknownDevice
        from cm.formats.bitstream.idcodes import device_by_idcode
        from cm.formats.bitstream.mask import mask_for
        from cm.formats.bitstream.readback import LoadedFrames as Loaded

        found = self._frames.pop(image.sha256, None)
        if found is None:
            device = device_by_idcode(image.idcode) if image.idcode is not None else None
            if device is None or image.encrypted:
                what = "is encrypted" if image.encrypted else "is for a device that is not known"
                raise UnknownDevice(f"{image.path} {what}: its frames cannot be compared")
            found = Loaded(device, open_image(self._reader.read(image)), mask_for(image.path, device))
        self._frames[image.sha256] = found
        while len(self._frames) > _FRAMES_KEPT:
            self._frames.pop(next(iter(self._frames)))
        return found

    # ---- what the kernel is given ---------------------------------------------------

    def clashes(self, overlays: Mapping[str, bytes], going: Collection[str]) -> Mapping[str, str]:
        """See `live_clashes`. Nothing is said where the kernel does not give back the overlays that are applied."""
        from cm.formats.live_tree import live_clashes

        try:
            there = {name: fdt.unpack((self._root / _OVERLAYS / name / "dtbo").read_bytes()) for name in going}
            wanted = {name: fdt.unpack(data) for name, data in overlays.items()}
            found = live_clashes(Root.of(self._root), wanted, [there])
        except (OSError, fdt.FdtError):
            return {}
        owners = {node.name: name for name, tree in wanted.items() for _, node in tree.walk()}
        said: dict[str, list[str]] = {}
        for clash in found:
            owner = owners.get(clash.node.rpartition("/")[2], clash.node)  # a label's clash names the overlay itself
            said.setdefault(owner, []).append(f"{clash.text} ({clash.advice})")
        return {name: "; ".join(sentences) for name, sentences in said.items()}

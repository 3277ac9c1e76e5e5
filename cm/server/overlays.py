# SPDX-License-Identifier: Apache-2.0
"""Device-tree overlays: what each would make the kernel load is checked before it is applied."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from cm.errors import CmError
from cm.formats import fdt
from cm.frozen import dataclass
from cm.manager.errors import BadOverlay
from cm.manager.interfaces import Image
from cm.schema.files import find_file, overlay_path
from cm.schema.model import Config, Module, Overlay
from cm.server.bitstream_files import BitstreamReader, FirmwareFolder

_NAME = "firmware-name"
_PARTIAL, _ENCRYPTED, _EXTERNAL = "partial-fpga-config", "encrypted-fpga-config", "external-fpga-config"
_KNOWN = (_PARTIAL, _ENCRYPTED, _EXTERNAL)
_DMABUF = "fpga-config-from-dmabuf"  # of linux-xlnx: it names no file that could be checked
_LOADING = frozenset({_NAME, _PARTIAL, _ENCRYPTED})


@dataclass(frozen=True, slots=True)
class FirmwareLoad:
    """What an overlay would make the kernel load: a name below /lib/firmware, and what it says of the image."""

    name: str
    partial: bool
    encrypted: bool


def checked_overlay(name: str, blob: bytes) -> bytes:
    """The blob, if it is a whole device tree with an ``__overlay__`` node. Raises BadOverlay."""
    if not any(_targets(_read(name, blob))):
        raise BadOverlay(f"{name}: no fragment has an __overlay__ node; compile an overlay (/plugin/;) with dtc")
    return blob


def firmware_loads(name: str, blob: bytes) -> tuple[FirmwareLoad, ...]:
    """Everything that applying an overlay would load. Raises BadOverlay, also if that cannot be known beforehand."""
    root = _read(name, blob)
    for _, node in root.walk():
        if _NAME in node.properties and node.name != "__overlay__" and _is_region(node):
            raise BadOverlay(
                f"{name}: node {node.name} adds an fpga-region with {_NAME}, which the kernel refuses: "
                "a region is loaded once it exists, by an overlay that targets it"
            )
    return tuple(_load(name, node) for node in _targets(root) if _says_of_loading(name, node))


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
    try:
        tree = fdt.read(blob)
    except fdt.FdtError as error:
        raise _no_tree(name, error) from error
    for node in _targets(tree.root):
        node.properties = properties(node)
    return fdt.write(tree)


def _read(name: str, blob: bytes) -> fdt.FdtNode:
    try:
        return fdt.unpack(blob)
    except fdt.FdtError as error:
        raise _no_tree(name, error) from error


def _no_tree(name: str, error: fdt.FdtError) -> BadOverlay:
    return BadOverlay(f"{name}: not a whole device-tree blob ({error}); compile it with dtc")


def _targets(root: fdt.FdtNode) -> Iterator[fdt.FdtNode]:
    return (node for _, node in root.walk() if node.name == "__overlay__")


def _is_region(node: fdt.FdtNode) -> bool:
    return b"fpga-region" in node.properties.get("compatible", b"").split(b"\0")


def _says_of_loading(name: str, node: fdt.FdtNode) -> bool:
    if _DMABUF in node.properties:
        raise BadOverlay(f"{name}: {_DMABUF} would load what cannot be looked at beforehand; name a file ({_NAME})")
    return _NAME in node.properties


def _unknown(node: fdt.FdtNode) -> str | None:
    """A property that makes linux-xlnx treat the image differently: user keys, authentication."""
    wanted = (key for key in node.properties if key.endswith("-fpga-config") or key == "encrypted-key-name")
    return next((key for key in wanted if key not in _KNOWN), None)


def _load(name: str, node: fdt.FdtNode) -> FirmwareLoad:
    if _EXTERNAL in node.properties:
        raise BadOverlay(f"{name}: {_NAME} and {_EXTERNAL} in one node contradict each other; the kernel refuses them")
    if (unknown := _unknown(node)) is not None:
        raise BadOverlay(
            f"{name}: {unknown} asks for a way of loading that is not supported; supported is {', '.join(_KNOWN)}"
        )
    value = node.properties[_NAME]
    if not value.endswith(b"\0") or value.count(b"\0") != 1 or len(value) < 2:
        raise BadOverlay(f"{name}: its {_NAME} {value!r} is not one name")
    return FirmwareLoad(
        value[:-1].decode("utf-8", "replace"), _PARTIAL in node.properties, _ENCRYPTED in node.properties
    )


_MAX_OVERLAY = 16 << 20  # bytes


class OverlayFiles:
    """The .dtbo files below a root. `read` reads one."""

    def __init__(
        self, root: Path, reader: BitstreamReader, firmware: FirmwareFolder, read: Callable[[Path], bytes]
    ) -> None:
        self._root = root
        self._reader = reader
        self._firmware = firmware
        self._read = read
        self._checked: dict[Path, tuple[tuple[object, ...], bytes]] = {}

    def beside(self, config: Config, overlay: Overlay, images: Sequence[Image]) -> bytes:
        """An overlay that comes with a configuration or mode whose `images` are in the device when it is applied.

        If it names them, they are not loaded a second time: a full image would erase what was loaded into its regions
        since. Raises FileMissing, and BadOverlay if it would load anything else.
        """
        path = overlay_path(config, overlay, self._root)
        data = self._overlay(path)
        loads = firmware_loads(str(path), data)
        for load in loads:
            self._known(path, config, load, images)
        return loading_nothing(str(path), data) if loads else data

    def loading(self, config: Config, module: Module, image: Image) -> bytes:
        """The overlay by which a module is loaded, naming our own copy of its image.

        Raises FileMissing, and BadOverlay if it names anything but that image, or is not an overlay for it.
        """
        path = find_file(config, [f"{module.name}.dtbo"], self._root)
        data = self._overlay(path)
        loads = firmware_loads(str(path), data)
        if len(loads) != 1:
            raise BadOverlay(f"{path}: one firmware-name is expected, there are {len(loads)}")
        self._known(path, config, loads[0], [image])
        return naming(str(path), data, self._firmware.private_name(image))

    def _overlay(self, path: Path) -> bytes:
        state = path.stat()
        key = (path, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)
        found = self._checked.get(path)
        if found is not None and found[0] == key:
            return found[1]
        if state.st_size > _MAX_OVERLAY:
            raise BadOverlay(
                f"{path}: {state.st_size} bytes are not an overlay; it has at most {_MAX_OVERLAY >> 20} MiB"
            )
        data = checked_overlay(str(path), self._read(path))
        self._checked[path] = (key, data)
        return data

    def _known(self, path: Path, config: Config, load: FirmwareLoad, images: Sequence[Image]) -> None:
        """Raise BadOverlay unless a firmware-name leads to one of the images, with the right flags for it."""
        what = f"{path}: its firmware-name {load.name!r}"
        try:
            place = self._place(path, config, load.name)
            image = next((image for image in images if self._reader.configures_as(place, image)), None)
        except (CmError, OSError) as error:
            raise BadOverlay(f"{what} cannot be used ({error})") from error
        if image is None:
            raise BadOverlay(f"{what} is {self._described(place)}; {_expected(images)}")
        _check_flags(what, load, image)

    def _place(self, path: Path, config: Config, name: str) -> Path:
        """The file that a name means: the package's own comes before those in the kernel's folders."""
        by_kernel = self._firmware.place(name)  # refuses names that leave the folder
        own = list(dict.fromkeys((path.parent, path.resolve().parent)))  # of an import, the overlay is a link
        places = [folder / name for folder in own]
        places += [self._firmware.folder / "cm" / config.name / name, by_kernel]
        places += [folder / other for folder in own for other in _spellings(name)]
        found = next((place for place in places if place.is_file()), None)
        if found is None:
            raise BadOverlay(f"there is no such file; looked for {', '.join(map(str, dict.fromkeys(places)))}")
        return found

    def _described(self, place: Path) -> str:
        report = self._reader.inspect(place)
        kind = "partial" if report.partial else "whole"
        why = f", which must not be loaded: {report.problems[0].message}" if report.problems else ""
        return f"another bitstream, {place} ({kind}, {report.design or report.device or 'of no known device'}){why}"


def _spellings(name: str) -> Iterator[str]:
    """Packages of dfx-mgr may name x.bit.bin where the folder holds x.bin, and the other way round."""
    stem = PurePosixPath(name).name.removesuffix(".bin").removesuffix(".bit")
    yield from (f"{stem}{suffix}" for suffix in (".bit.bin", ".bin", ".bit"))


def _expected(images: Sequence[Image]) -> str:
    if not images:
        return "the plan loads nothing of that kind: list it as a module, or as the bitstream of a full configuration"
    return f"the plan knows {', '.join(str(image.path) for image in images)}"


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

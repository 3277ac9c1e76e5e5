# SPDX-License-Identifier: Apache-2.0
"""The overlay tree of configfs, as linux-xlnx and dtbocfg offer it."""

from __future__ import annotations

import errno
import itertools
import socket
from collections.abc import Mapping

from cm.formats.fdt import FdtError, FdtNode, unpack
from cm.formats.fdt_overlay import targets
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.nodes.attributes import AttributeNode, FolderNode
from cm.simulation.software.nodes.fpga_manager import PARTIAL, FpgaManager
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.server import Server
from cm.simulation.software.transport.session import Later

BASE = "sys/kernel/config/device-tree/overlays"
_SPARE = "sim/overlays"
_APPLIED, _UNAPPLIED = "applied\n", "unapplied\n"
_FILES = ("dtbo", "path", "status")
_BUS, _DRIVER, _UIO = "sys/bus/platform", "uio_pdrv_genirq", b"fpga-cm,uio"
_Listeners = tuple[socket.socket, socket.socket]  # of `dtbo` and `path`


class Overlays:
    """Folders of overlays; applying one with a firmware-name loads it through the fpga_manager."""

    def __init__(self, root: Root, manager: FpgaManager, faults: Faults) -> None:
        self._root, self._manager, self._faults = root, manager, faults
        self._server: Server | None = None
        self._targets: dict[str, str] = {}  # target of a firmware overlay → the overlay
        self._probes = Probes(root, faults)
        self._folders: dict[str, _Folder] = {}
        self._spare: dict[str, _Listeners] = {}  # folders of earlier overlays, by where they wait for another one
        self._places = itertools.count()

    def serve(self, server: Server) -> None:
        """Make the folder and listen."""
        self._server = server
        self._root.mkdir(_SPARE)
        server.listen(self._root.bind(f"{BASE}/.node"), FolderNode(self._mkdir, self._rmdir))

    @property
    def applied(self) -> list[str]:
        """Names of those that are applied, in order."""
        return [name for name, folder in self._folders.items() if folder.applied]

    def _mkdir(self, name: str) -> None:
        if name in self._folders:
            raise NodeError(errno.EEXIST, f"overlay {name} exists")
        folder = _Folder(name, self._root, self._manager, self._faults, self._targets, self._probes)
        if self._spare:
            place, listeners = self._spare.popitem()
            self._root.move(place, folder.base, _FILES)
        else:
            listeners = self._root.bind(f"{folder.base}/dtbo"), self._root.bind(f"{folder.base}/path")
            self._root.write(f"{folder.base}/status", _UNAPPLIED)
        assert self._server is not None
        folder.listen(self._server, listeners)
        self._folders[name] = folder

    def _rmdir(self, name: str) -> None:
        """Put its folder where the next overlay takes it from: that is quicker than to make and to remove each."""
        if name not in self._folders:
            raise NodeError(errno.ENOENT, f"there is no overlay {name}")
        if self._folders[name].loading:
            raise NodeError(errno.EBUSY, f"overlay {name} is being applied")
        folder = self._folders.pop(name)
        for target in [target for target, overlay in self._targets.items() if overlay == name]:
            del self._targets[target]
        self._probes.removed(name)
        place = f"{_SPARE}/{next(self._places)}"
        self._root.move(folder.base, place, _FILES)
        assert self._server is not None
        self._server.loop.call_soon(lambda: self._tidied(place, folder.listeners))  # after the answer

    def _tidied(self, place: str, listeners: _Listeners) -> None:
        self._root.write(f"{place}/status", _UNAPPLIED)
        self._spare[place] = listeners


class _Folder:
    """One overlay: ``dtbo`` and ``path`` are sockets, ``status`` is a plain file."""

    def __init__(
        self, name: str, root: Root, manager: FpgaManager, faults: Faults, targets: dict[str, str], probes: Probes
    ) -> None:
        self._name, self._root, self._manager, self._faults, self._probes = name, root, manager, faults, probes
        self.base = f"{BASE}/{name}"
        self._targets = targets
        self._blob = b""
        self._path = b"\n"
        self.applied = False
        self.loading = False

    def listen(self, server: Server, listeners: _Listeners) -> None:
        self.listeners = listeners
        server.listen(listeners[0], AttributeNode(lambda: self._blob, self._write_dtbo))
        server.listen(listeners[1], AttributeNode(lambda: self._path, self._write_path))

    def _write_path(self, data: bytes) -> Later | None:
        later = self._write_dtbo(self._root.firmware(data.rstrip(b"\n").decode("utf-8", "replace")))
        self._path = data.rstrip(b"\n") + b"\n"
        return later

    def _write_dtbo(self, blob: bytes) -> Later | None:
        if self.applied or self.loading:
            raise NodeError(errno.EPERM, "the overlay is applied already")
        if self._faults.take("overlay_error", self._name):
            raise NodeError(errno.EINVAL, "injected")
        try:
            tree = unpack(blob)
            aims = targets(tree)
        except FdtError as error:
            raise NodeError(errno.EINVAL, str(error)) from error
        found = [fragment for fragment in tree.children if fragment.child("__overlay__") is not None]
        if not found:
            raise NodeError(errno.EINVAL, "no fragment has an __overlay__")
        return self._apply(blob, found, aims)

    def _apply(self, blob: bytes, fragments: list[FdtNode], aims: Mapping[str, str]) -> Later | None:
        for target in aims.values():
            if target in self._targets:
                # of_fpga_region_notify_pre_apply: "Region already has overlay applied."; any other is refused as well
                raise NodeError(errno.EINVAL, f"{target} has overlay {self._targets[target]} applied")
        for fragment in fragments:
            node = fragment.child("__overlay__")
            firmware = node.text("firmware-name") if node is not None else None
            if node is not None and firmware:
                partial = "partial-fpga-config" in node.properties
                return self._load(blob, aims.get(fragment.name, ""), firmware, partial, fragments)
        self._done(blob, fragments)
        return None

    def _load(self, blob: bytes, target: str, firmware: str, partial: bool, fragments: list[FdtNode]) -> Later:
        self.loading = True
        later = Later()

        def finished(result: bytes | NodeError) -> None:
            self.loading = False
            if not isinstance(result, NodeError):
                self._targets[target] = self._name
                self._done(blob, fragments)
            later.finish(result)

        self._manager.load(firmware, PARTIAL if partial else 0).then(finished)
        return later

    def _done(self, blob: bytes, fragments: list[FdtNode]) -> None:
        self._blob, self.applied = blob, True
        self._root.write(f"{self.base}/status", _APPLIED)
        self._probes.applied(self._name, fragments)


class Probes:
    """What the kernel shows of devices whose driver did not take them; the others need no files here.

    That is so for a fault `probe_error`, and for an interrupt that two devices for UIO have, which does not share any.
    """

    def __init__(self, root: Root, faults: Faults) -> None:
        self._root, self._faults = root, faults
        self._held: dict[bytes, tuple[str, str]] = {}  # controller and interrupt → overlay and device
        self._files: dict[str, list[str]] = {}  # of an overlay

    def applied(self, overlay: str, fragments: list[FdtNode]) -> None:
        """The nodes of an overlay are probed."""
        for node in (node for fragment in fragments for _, node in fragment.walk()):
            if _UIO not in node.properties.get("compatible", b"").split(b"\0"):
                continue
            name, interrupt = node.name.partition("@")[0], node.properties.get("interrupts", b"")
            device = f"{node.name.partition('@')[2]}.{name}".lstrip(".")
            line = node.properties.get("interrupt-parent", b"") + interrupt
            holder = self._held.setdefault(line, (overlay, device))[1] if interrupt else device
            if holder != device:
                self._show(overlay, holder, interrupt, bound=True)
            if holder != device or self._faults.take("probe_error", name):
                self._show(overlay, device, interrupt, bound=False)

    def _show(self, overlay: str, device: str, interrupt: bytes, bound: bool) -> None:
        place = f"{_BUS}/devices/{device}"
        files = {f"{place}/of_node/compatible": _UIO + b"\0", f"{place}/of_node/interrupts": interrupt}
        files[f"{_BUS}/drivers/{_DRIVER}/bind"] = b""
        for path, content in files.items():
            self._root.write(path, content)
        if bound:
            self._root.link(f"{place}/driver", f"../../drivers/{_DRIVER}")
            files[f"{place}/driver"] = b""
        self._files.setdefault(overlay, []).extend((*files, f"{place}/of_node", place))

    def removed(self, overlay: str) -> None:
        """An overlay's devices go."""
        self._held = {line: held for line, held in self._held.items() if held[0] != overlay}
        for path in dict.fromkeys(self._files.pop(overlay, [])):
            self._root.remove(path)

# SPDX-License-Identifier: Apache-2.0
"""What a board's kernel says in /proc and /sys; what cannot be read is empty."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from pathlib import Path

from cm.device.paths import Root
from cm.frozen import dataclass

FAMILIES = {"xlnx,zynq-7000": "zynq", "xlnx,zynqmp": "zynqmp"}


@dataclass(frozen=True, slots=True)
class PlatformDevice:
    """A device of the platform bus that came from the device tree; `base` is its address, where it has one."""

    name: str
    path: Path
    compatible: tuple[str, ...]
    driver: str  # empty: none is bound
    properties: frozenset[str]

    @property
    def node(self) -> str:
        """Path of its node in the tree; empty where the link to it cannot be read."""
        try:
            return str((self.path / "of_node").readlink()).partition("/devicetree/base")[2]
        except OSError:
            return ""

    @property
    def base(self) -> int | None:
        """Physical address, from the device's name (``a0000000.dma-controller``)."""
        head, dot, _ = self.name.partition(".")
        try:
            return int(head, 16) if dot else None
        except ValueError:
            return None

    def cell(self, name: str) -> int | None:
        """A property of one cell; None if there is none."""
        try:
            data = (self.path / "of_node" / name).read_bytes()
        except OSError:
            return None
        return int.from_bytes(data[:4], "big") if len(data) >= 4 else None


class Machine:
    """One look at the machine below a root."""

    def __init__(self, root: Root) -> None:
        """`root` is where /proc and /sys begin."""
        self.root = root

    def text(self, *parts: str) -> str:
        """The content of a small file, without its end; empty if there is none."""
        return self.raw(*parts).decode("utf-8", "replace").strip("\0\n ")

    def raw(self, *parts: str) -> bytes:
        """The content of a small file; empty if there is none."""
        try:
            return self.root.join(*parts).read_bytes()
        except OSError:
            return b""

    def exists(self, *parts: str) -> bool:
        """Whether a path exists."""
        return self.root.join(*parts).exists()

    def names(self, *parts: str) -> list[str]:
        """Names in a folder, sorted; none if it cannot be listed."""
        try:
            return sorted(entry.name for entry in self.root.join(*parts).iterdir())
        except OSError:
            return []

    @cached_property
    def compatible(self) -> tuple[str, ...]:
        """Compatible strings of the board."""
        return tuple(self.text("proc/device-tree/compatible").split("\0"))

    @cached_property
    def family(self) -> str | None:
        """``zynq`` or ``zynqmp``; None for other machines."""
        return next((FAMILIES[name] for name in self.compatible if name in FAMILIES), None)

    @cached_property
    def release(self) -> str:
        """The kernel's release."""
        return self.text("proc/sys/kernel/osrelease")

    @cached_property
    def command_line(self) -> tuple[str, ...]:
        """Words of the kernel's command line."""
        return tuple(self.text("proc/cmdline").split())

    @cached_property
    def loaded(self) -> frozenset[str]:
        """Modules that are loaded."""
        return frozenset(line.split(" ", 1)[0] for line in self.text("proc/modules").splitlines())

    @cached_property
    def built_in(self) -> frozenset[str]:
        """Modules that are part of the kernel."""
        paths = self.text("lib/modules", self.release, "modules.builtin").splitlines()
        return frozenset(Path(path).name.partition(".")[0].replace("-", "_") for path in paths)

    def has_module(self, name: str) -> bool | None:
        """Whether the running kernel has a module, loaded or not; None where that cannot be known."""
        if name in self.loaded or name in self.built_in:
            return True
        return name in self._modules if self._modules else None

    @cached_property
    def _modules(self) -> frozenset[str]:
        """Modules that lie below /lib/modules."""
        paths = [line.partition(":")[0] for line in self.text("lib/modules", self.release, "modules.dep").splitlines()]
        return frozenset(path.rpartition("/")[2].partition(".ko")[0].replace("-", "_") for path in paths)

    @cached_property
    def devices(self) -> tuple[PlatformDevice, ...]:
        """Devices of the platform bus that have a node in the device tree."""
        return tuple(self.devices_named(self.names("sys/bus/platform/devices")))

    def devices_named(self, names: Iterable[str]) -> Iterator[PlatformDevice]:
        """Some of them, as they are now."""
        folder = self.root.join("sys/bus/platform/devices")
        for name in names:
            path = folder / name
            try:
                node = (path / "of_node/compatible").read_bytes().decode("ascii", "replace")
                properties = frozenset(entry.name for entry in (path / "of_node").iterdir())
            except OSError:
                continue
            driver = path / "driver"
            bound = driver.readlink().name if driver.is_symlink() else ""
            yield PlatformDevice(name, path, tuple(node.strip("\0").split("\0")), bound, properties)

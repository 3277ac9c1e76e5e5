# SPDX-License-Identifier: Apache-2.0
"""`Overlay`: a configuration that `cm import pynq` made of a `.bit`, with blocks as its `.hwh` describes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, ClassVar

from cm.errors import NotFound
from cm.formats import hwh as handoff
from cm.formats.importers import channel_names, described_by, to_name
from cm.formats.registers import RegisterInfo
from cm.pynq.board import Interrupt, board, places
from cm.pynq.mmio import MMIO, Named, RegisterMap

Description = Mapping[str, Any]


class DefaultIP:
    """A block. The overlay gives a subclass where one's `bindto` names the block's VLNV, with or without version."""

    bindto: ClassVar[Sequence[str]] = ()
    drivers: ClassVar[dict[str, type[DefaultIP]]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for vlnv in vars(cls).get("bindto", ()):
            DefaultIP.drivers[vlnv] = DefaultIP.drivers[vlnv.rpartition(":")[0]] = cls

    def __init__(self, description: Description) -> None:
        """`description` is an entry of `Overlay.ip_dict`. Interrupts are attributes by the names of their ports."""
        self.description = description
        self.mmio = MMIO(description["phys_addr"], description["addr_range"])
        for name, pin in description.get("interrupts", {}).items():
            setattr(self, name, Interrupt(pin["fullpath"]))

    @property
    def register_map(self) -> RegisterMap:
        """Registers by name."""
        return RegisterMap(self.mmio, self.description["registers"])

    def read(self, offset: int = 0) -> int:
        """A word of the window."""
        return self.mmio.read(offset)

    def write(self, offset: int, value: Any) -> None:
        """Write a word, or bytes, into the window."""
        self.mmio.write(offset, value)


class DefaultHierarchy(Named):
    """Blocks as attributes. A subclass whose `checkhierarchy` accepts a hierarchy is what the overlay gives for it."""

    drivers: ClassVar[list[type[DefaultHierarchy]]] = []

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        DefaultHierarchy.drivers.insert(0, cls)

    def __init__(self, description: Description) -> None:
        self.description = description
        self._known = {**description["hierarchies"], **description["ip"]}

    @staticmethod
    def checkhierarchy(description: Description) -> bool:  # noqa: ARG004 (for subclasses)
        """Whether the class is for this one; `description` has blocks in `ip`, hierarchies in `hierarchies`."""
        return False

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return vars(self).setdefault(name, _made(self._find(name)))


def _made(description: Description) -> Any:
    if "hierarchies" in description:
        accepting = (kind for kind in DefaultHierarchy.drivers if kind.checkhierarchy(description))
        return next(accepting, DefaultHierarchy)(description)
    drivers, vlnv = DefaultIP.drivers, description["type"]
    return drivers.get(vlnv, drivers.get(vlnv.rpartition(":")[0], DefaultIP))(description)


class PL:
    """What this program's last overlay was."""

    bitfile_name: ClassVar[str] = ""
    ip_dict: ClassVar[dict[str, Any]] = {}

    @classmethod
    def reset(cls) -> None:
        """Forget it; what is loaded stays."""
        cls.bitfile_name, cls.ip_dict = "", {}


class Overlay(DefaultHierarchy):
    """The design of a `.bit`, of which `cm import pynq` has made a configuration; blocks are attributes.

    Loading is the manager's: checked first, undone if it fails. Raises FileNotFoundError without the `.bit` or `.hwh`.
    """

    def __init__(self, bitfile_name: str, dtbo: str | None = None, download: bool = True, **_: Any) -> None:
        """`dtbo` may be the one of the bitstream's name alone; PYNQ's further arguments have no effect."""
        bit = Path(bitfile_name).absolute()
        if not bit.is_file():
            raise FileNotFoundError(f"Bitstream file {bitfile_name} does not exist. Name the one that was imported.")
        self.bitfile_name, self._name = str(bit), to_name(bit.stem)
        self.ip_dict = _blocks(handoff.read(described_by(bit)))
        self.hierarchy_dict = _hierarchies(self.ip_dict)
        super().__init__(self.hierarchy_dict.pop(""))
        if download:
            self.download(dtbo)
        PL.bitfile_name, PL.ip_dict = self.bitfile_name, self.ip_dict

    def download(self, dtbo: str | None = None) -> None:
        """Load it, anew if it is loaded already. Raises NotFound without the configuration, and as `Board.load`."""
        _check_dtbo(Path(self.bitfile_name), dtbo)
        if self._name not in board().configs:
            raise NotFound(
                f"the manager has no configuration {self._name!r}: `cm import pynq {self.bitfile_name} --out DIR`, DIR "
                "being a folder that it reads, makes one; a manager that runs sees it after a reload or restart"
            )
        board().load(self._name, force=True)
        places().refresh()

    def pr_download(self, partial_region: str, partial_bit: str, dtbo: str | None = None, program: bool = True) -> None:
        """Load a partial bitstream into a region: the mode of its name. The manager decouples, checks, undoes.

        Raises NotFound for a region or a bitstream that the configuration does not have.
        """
        _check_dtbo(Path(partial_bit), dtbo)
        if to_name(partial_region) not in board().regions:
            raise NotFound(f"no region {partial_region!r}; there are: {', '.join(board().regions) or 'none'}")
        if program:
            board().mode = to_name(Path(partial_bit).stem)
            places().refresh()

    def is_loaded(self) -> bool:
        """Whether the board has it now, whoever loaded it."""
        return board().status.config_name == self._name

    def free(self) -> None:
        """Nothing: it stays loaded until another one is, as in PYNQ."""

    def _inside(self) -> Mapping[str, Any]:
        if not self.is_loaded():
            raise RuntimeError("Overlay not currently loaded")
        return super()._inside()


def _check_dtbo(bit: Path, dtbo: str | None) -> None:
    if dtbo is not None and Path(dtbo).stem != bit.stem:
        raise NotImplementedError(
            f"dtbo={dtbo!r}: the manager applies the configuration's overlays; import takes {bit.stem}.dtbo"
        )


def _blocks(hwh: handoff.Hwh) -> dict[str, dict[str, Any]]:
    """`ip_dict`: what the processor reaches, by path. Beside PYNQ's keys, `channels`: the streams of a DMA."""
    found: dict[str, dict[str, Any]] = {}
    channels, lines = channel_names(hwh), handoff.interrupts(hwh)
    for window in (*handoff.windows(hwh), *handoff.memories(hwh)):
        module = hwh.modules.get(window.instance)
        if module is None or (path := module.path.strip("/")) in found:
            continue
        found[path] = {
            "type": module.vlnv,
            "phys_addr": window.base,
            "addr_range": window.size,
            "fullpath": path,
            "mem_id": window.interface,
            "parameters": dict(module.parameters),
            "registers": {info.name: _register(info) for info in handoff.registers(module, window.interface)},
            "interrupts": {
                pin.port: {"controller": pin.controller or "", "index": pin.index, "fullpath": f"{path}/{pin.port}"}
                for pin in lines
                if pin.instance == window.instance
            },
            "channels": {one.direction: name for one, name in channels.items() if one.instance == window.instance},
        }
    return found


def _register(info: RegisterInfo) -> dict[str, Any]:
    access = info.access or "read-write"
    fields = {
        one.name: {
            "bit_offset": one.lsb,
            "bit_width": one.width,
            "access": one.access or access,
            "description": one.doc,
        }
        for one in info.fields
    }
    known = {"address_offset": info.offset, "size": info.size, "access": access, "description": info.doc}
    return {**known, "fields": fields}


def _hierarchies(found: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """`hierarchy_dict`: by path, each with the blocks and the hierarchies right in it by name; the design is ``""``."""
    made: dict[str, dict[str, Any]] = {"": {"ip": {}, "hierarchies": {}}}
    for path, block in found.items():
        there, (*above, name) = made[""], path.split("/")
        for full, last in zip(accumulate(above, "{}/{}".format), above, strict=True):
            new = {"fullpath": full, "ip": {}, "hierarchies": {}}
            there["hierarchies"][last] = there = made.setdefault(full, new)
        there["ip"][name] = block
    return made

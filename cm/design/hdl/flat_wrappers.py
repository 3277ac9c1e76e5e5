# SPDX-License-Identifier: Apache-2.0
"""Flat wrappers: they present a top with SystemVerilog interfaces or VHDL records as a module with vector ports."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import ModuleInfo, PortDirection
from cm.frozen import dataclass

IN, OUT = PortDirection.IN, PortDirection.OUT


@dataclass(frozen=True, slots=True)
class FlatPort:
    """A port of a wrapper; `inner`: its signal in the interface or record, or "" for a port passed through."""

    name: str
    direction: PortDirection
    width: int
    inner: str = ""
    kind: str = ""  # VHDL: the type of `inner` where it must be converted
    default: str = ""  # VHDL: of an input that is passed through


@dataclass(frozen=True, slots=True)
class Flat:
    """A wrapper: module or entity `name`, in a file of that name and `suffix`."""

    name: str
    suffix: str
    text: str

    @property
    def file(self) -> str:
        """Name of its file."""
        return self.name + self.suffix


def needs_wrapper(info: ModuleInfo) -> bool:
    """Whether any port is not a vector."""
    return any(not port.flat for port in info.ports)


def wrapper_name(top: str) -> str:
    """The wrapper's module."""
    return f"cm_flat_{top}"


def unique_ports(where: str, ports: Sequence[FlatPort]) -> None:
    """Raise `HdlError` if two ports of a wrapper would have the same name."""
    seen: set[str] = set()
    for port in ports:
        if port.name.lower() in seen:
            raise HdlError(
                f"{where}: its flat wrapper would have two ports {port.name}: rename one, or wrap it by hand"
            )
        seen.add(port.name.lower())


def field_name(port: str, path: Sequence[str], stream: bool) -> str:
    """The flat name of a record's field: ``axi_m2s.read.ar.addr`` is ``axi_araddr``, as buses are named.

    `stream`: the fields are those of a stream without their ``t``.
    """
    base = re.sub(r"_?(?:(?:read|write)_?)?(?:m2s|s2m|mosi|miso|master|slave)$", "", port, flags=re.IGNORECASE) or port
    words = [word.lower() for word in path]
    words = [word for word in words[:-1] if word not in ("read", "write")] + words[-1:]
    words[-1] = {"strobe": "strb"}.get(words[-1], words[-1])
    if stream:
        words[-1] = "t" + words[-1]
    if len(words) > 1 and words[-2] in ("aw", "w", "b", "ar", "r"):
        words[-2:] = [words[-2] + words[-1]]
    return "_".join([base, *words])

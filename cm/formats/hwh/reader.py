# SPDX-License-Identifier: Apache-2.0
"""A `.hwh` (XML) as frozen data, in Vivado's own terms."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

from cm.errors import CmError
from cm.formats.registers import RegisterField, RegisterInfo
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class ConnectedPort:
    """The other end of a port: an instance and its port."""

    instance: str
    port: str


@dataclass(frozen=True, slots=True)
class InstancePort:
    """A port: `direction` I, O or IO; `kind` is SIGIS (``INTERRUPT``, ``clk``, …); `width` in bits, `rate` in Hz.

    `sensitivity` of an interrupt: ``LEVEL_HIGH``, ``EDGE_RISING``, … or empty.
    """

    name: str
    direction: str
    kind: str
    signal: str
    width: int
    connections: tuple[ConnectedPort, ...]
    rate: int = 0
    sensitivity: str = ""
    polarity: str = ""  # ACTIVE_LOW or ACTIVE_HIGH


@dataclass(frozen=True, slots=True)
class BusInterface:
    """A bus interface: `type` MASTER, SLAVE, INITIATOR or TARGET; `bus` the net it is on."""

    name: str
    type: str
    bus: str
    vlnv: str
    parameters: Mapping[str, str]
    ports: Mapping[str, str]  # by logical signal


@dataclass(frozen=True, slots=True)
class MemoryRange:
    """Addresses of a slave as one master sees it; `high` is the last byte's."""

    instance: str
    interface: str
    block: str
    base: int
    high: int
    kind: str  # REGISTER or MEMORY

    @property
    def size(self) -> int:
        """Bytes."""
        return self.high - self.base + 1


@dataclass(frozen=True, slots=True)
class ModuleInstance:
    """An IP in the design. `region`: it is a reconfigurable block design container or module (RBD)."""

    instance: str
    path: str
    type: str  # e.g. axi_gpio
    vlnv: str
    region: bool
    parameters: Mapping[str, str]
    ports: Mapping[str, InstancePort]
    interfaces: tuple[BusInterface, ...]
    registers: Mapping[str, tuple[RegisterInfo, ...]]  # by the interface of the address block
    ranges: tuple[MemoryRange, ...]  # what this instance can address

    @property
    def name(self) -> str:
        """The last part of the path: the instance's own name in its hierarchy."""
        return self.path.rsplit("/", 1)[-1]


@dataclass(frozen=True, slots=True)
class Hwh:
    """A whole file: `device` without package, e.g. ``7z020``."""

    design: str
    device: str
    vivado: str
    timestamp: str
    modules: Mapping[str, ModuleInstance]  # by instance
    external_ranges: tuple[MemoryRange, ...]  # through an external slave port: the only ones in a partial design's file


DECIMAL = re.compile(r"\d+\.\d+([eE][+-]?\d\d?)?|\d+[eE][+-]?\d\d?")
_LIMIT = 64 * 1024 * 1024  # bytes; the largest real files have a few MiB


class HwhError(CmError, ValueError):
    """A file that is not a hardware handoff."""

    code = "hwh"


def root_of(data: bytes) -> ElementTree.Element:
    """The root of any tool's XML. Raises ValueError with what is wrong, whichever part of the parser found it."""
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError) as error:  # LookupError: an unknown encoding
        raise ValueError(str(error)) from error


def read(path: Path, name: str = "") -> Hwh:
    """Read a file. Raises `HwhError` with the file's name (or `name` in its place), or OSError."""
    return parse(path.read_bytes(), name or str(path))


def parse(data: bytes, name: str = ".hwh") -> Hwh:
    """Read the bytes of a file; `name` is for messages."""
    if len(data) > _LIMIT:
        raise HwhError(f"{name}: {len(data)} bytes are not a hardware handoff")
    if b"\0" in data:  # UTF-16 would hide a document type from the next check
        raise HwhError(f"{name}: no UTF-8 text")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise HwhError(f"{name}: a document type or entities have no place in a hardware handoff")
    try:
        root = root_of(data)
    except ValueError as error:
        raise HwhError(f"{name}: not XML: {error}") from error
    info = root.find("SYSTEMINFO")
    if root.tag != "EDKSYSTEM" or info is None:
        raise HwhError(f"{name}: no hardware handoff: EDKSYSTEM with SYSTEMINFO expected, found {root.tag}")
    try:
        return _hwh(root, info)
    except ValueError as error:
        raise HwhError(f"{name}: {error}") from error


def _hwh(root: ElementTree.Element, info: ElementTree.Element) -> Hwh:
    modules = {module.instance: module for module in map(_module, root.iterfind("MODULES/MODULE"))}
    return Hwh(
        design=info.get("NAME", ""),
        device=info.get("DEVICE", ""),
        vivado=root.get("VIVADOVERSION", ""),
        timestamp=root.get("TIMESTAMP", ""),
        modules=MappingProxyType(modules),
        external_ranges=tuple(_ranges(root.iterfind("EXTERNALINTERFACES//MEMRANGE"))),
    )


def _number(text: str | None, what: str) -> int:
    """Read a number as Vivado writes it: decimal, 0x, or with underscores."""
    try:
        return int((text or "").replace("_", "") or "0", 0)
    except ValueError:
        raise ValueError(f"{what} {text!r} is not a number") from None


def _rate(text: str | None, what: str) -> int:
    """Read a rate in Hz: a whole number, or since 2022 a decimal one (``93750000.0``, ``1e+08``)."""
    return round(float(text)) if text and DECIMAL.fullmatch(text) else _number(text, what)


def _module(element: ElementTree.Element) -> ModuleInstance:
    instance = element.get("INSTANCE", "")
    parameters = {item.get("NAME", ""): item.get("VALUE", "") for item in element.iterfind("PARAMETERS/PARAMETER")}
    blocks: dict[str, tuple[RegisterInfo, ...]] = {}
    for block in element.iterfind("ADDRESSBLOCKS/ADDRESSBLOCK"):
        found = tuple(register for item in block.iterfind("REGISTERS/REGISTER") for register in _register(item))
        if found:
            key = block.get("INTERFACE", "")
            blocks[key] = blocks.get(key, ()) + found
    return ModuleInstance(
        instance=instance,
        path=element.get("FULLNAME", "/" + instance),
        type=element.get("MODTYPE", ""),
        vlnv=element.get("VLNV", ""),
        region=element.get("BDTYPE") == "RBD",
        parameters=MappingProxyType(parameters),
        ports=MappingProxyType({port.name: port for port in map(_port, element.iterfind("PORTS/PORT"))}),
        interfaces=tuple(map(_interface, element.iterfind("BUSINTERFACES/BUSINTERFACE"))),
        registers=MappingProxyType(blocks),
        ranges=tuple(_ranges(element.iterfind("MEMORYMAP/MEMRANGE"))),
    )


def _port(element: ElementTree.Element) -> InstancePort:
    left, right = (_number(element.get(key), f"port {element.get('NAME')}: {key}") for key in ("LEFT", "RIGHT"))
    ends = element.iterfind("CONNECTIONS/CONNECTION")
    return InstancePort(
        name=element.get("NAME", ""),
        direction=element.get("DIR", ""),
        kind=element.get("SIGIS", ""),
        signal=element.get("SIGNAME", ""),
        width=abs(left - right) + 1,
        connections=tuple(ConnectedPort(end.get("INSTANCE", ""), end.get("PORT", "")) for end in ends),
        rate=_rate(element.get("CLKFREQUENCY"), f"port {element.get('NAME')}: CLKFREQUENCY"),
        sensitivity=element.get("SENSITIVITY", ""),
        polarity=element.get("POLARITY", ""),
    )


def _interface(element: ElementTree.Element) -> BusInterface:
    parameters = {item.get("NAME", ""): item.get("VALUE", "") for item in element.iterfind("PARAMETER")}
    ports = {item.get("LOGICAL", ""): item.get("PHYSICAL", "") for item in element.iterfind("PORTMAPS/PORTMAP")}
    name, kind, bus, vlnv = (element.get(key, "") for key in ("NAME", "TYPE", "BUSNAME", "VLNV"))
    return BusInterface(name, kind, bus, vlnv, MappingProxyType(parameters), MappingProxyType(ports))


def _ranges(elements: Iterator[ElementTree.Element]) -> Iterator[MemoryRange]:
    for element in elements:
        base, high = (
            _number(element.get(key), f"memory range of {element.get('INSTANCE')}: {key}")
            for key in ("BASEVALUE", "HIGHVALUE")
        )
        if high >= base:
            yield MemoryRange(
                instance=element.get("INSTANCE", ""),
                interface=element.get("SLAVEBUSINTERFACE", ""),
                block=element.get("ADDRESSBLOCK", ""),
                base=base,
                high=high,
                kind=element.get("MEMTYPE", ""),
            )


def _properties(element: ElementTree.Element) -> dict[str, str]:
    return {item.get("NAME", ""): item.get("VALUE", "") for item in element.iterfind("PROPERTY")}


def _register(element: ElementTree.Element) -> Iterator[RegisterInfo]:
    """The register, unless it is switched off in this instance."""
    name, found = element.get("NAME", ""), _properties(element)
    if found.get("IS_ENABLED", "true").lower() == "false":
        return
    reset = found.get("RESET_VALUE")
    yield RegisterInfo(
        name=name,
        offset=_number(found.get("ADDRESS_OFFSET"), f"register {name}: offset"),
        size=_number(found.get("SIZE") or "32", f"register {name}: size"),
        access=found.get("ACCESS", ""),
        reset=_number(reset, f"register {name}: reset value") if reset else None,
        fields=tuple(map(_field, element.iterfind("FIELDS/FIELD"))),
        doc=found.get("DESCRIPTION", "").strip(),
    )


def _field(element: ElementTree.Element) -> RegisterField:
    name, found = element.get("NAME", ""), _properties(element)
    names = ("MODIFIED_WRITE_VALUE", "MODIFIED_READ_VALUES")  # Vivado writes the latter, and means the former
    write, read = next(filter(None, map(found.get, names)), ""), found.get("READ_ACTION", "")
    return RegisterField(
        name=name,
        lsb=_number(found.get("BIT_OFFSET"), f"field {name}: bit offset"),
        width=_number(found.get("BIT_WIDTH") or "1", f"field {name}: bit width"),
        access=found.get("ACCESS", ""),
        write="" if write == "modify" else write,  # which Vivado says of all fields
        read="" if read == "modify" else read,
        doc=found.get("DESCRIPTION", "").strip(),
    )

# SPDX-License-Identifier: Apache-2.0
"""IP-XACT component files (IEEE 1685-2009 `spirit`, as Vivado writes `component.xml`) as `ModuleInfo`.

Names are compared without namespace, so that 1685-2014 files of the same shape load too.

Elements of IP-XACT files by their names without namespace, so that 1685-2009 and 1685-2014 read alike.

The files that an IP-XACT component's synthesis view lists.

Reads Vivado's IP instances (.xci) since 2020.2: JSON with the instance's name and ports as customised.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cm.design.hdl.associate import associate
from cm.design.hdl.axi_signals import make_protocol
from cm.design.hdl.detect import detect
from cm.design.hdl.errors import HdlError
from cm.design.hdl.model import (
    FoundBy,
    Interface,
    Interrupt,
    Language,
    Leftover,
    Mode,
    ModuleInfo,
    Parameter,
    Port,
    PortDirection,
    Reset,
)
from cm.design.hdl.user_protocols import UserProtocol
from cm.design.hdl.validate_bus import make_interface
from cm.design.hdl.vivado_attributes import clock_of, polarity_of
from cm.formats.hwh.reader import root_of
from cm.frozen import dataclass, field, replace


def component_root(data: bytes) -> ElementTree.Element:
    """Parse a file's bytes and return the root element. Raises ValueError for what is not XML.

    Real files have licence comments before the XML declaration, although XML does not allow that.
    """
    return root_of(data[max(data.find(b"<?xml"), 0) :])


def local(tag: str) -> str:
    """A tag or an attribute's name without namespace; empty for a comment, whose tag is not text."""
    return tag.rpartition("}")[2] if isinstance(tag, str) else ""


def children(node: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Direct children of this name."""
    return (child for child in node if local(child.tag) == name)


def below(node: ElementTree.Element, *names: str) -> list[ElementTree.Element]:
    """Children of children, along these names."""
    found = [node]
    for name in names:
        found = [child for parent in found for child in children(parent, name)]
    return found


def descendants(node: ElementTree.Element, name: str) -> Iterator[ElementTree.Element]:
    """Elements of this name at any depth, in document order."""
    return (child for child in node.iter() if local(child.tag) == name)


def text_of(node: ElementTree.Element, name: str) -> str:
    """Text of the first direct child of this name, without surrounding white space; empty if there is none."""
    found = next(children(node, name), None)
    return (found.text or "").strip() if found is not None else ""


_MODES = {
    "master": Mode.MASTER,
    "mirroredSlave": Mode.MASTER,
    "slave": Mode.SLAVE,
    "mirroredMaster": Mode.SLAVE,
    "monitor": Mode.MONITOR,
}
_SIGNALS = ("clock", "reset", "interrupt")
_LEFT_OVER = "belongs to no bus interface of the component"


def load_component_xml(path: str | Path) -> ModuleInfo:
    """Read a component.xml. Raises `HdlError` where it is not an IP-XACT component.

    The name is the model name of the synthesis view (the HDL's top), else the component's.
    """
    path = Path(path)
    try:
        root = component_root(path.read_bytes())
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise HdlError(f"{path}: not XML: {error}") from error
    if local(root.tag) != "component":
        raise HdlError(f"{path}: not an IP-XACT component: its root is <{local(root.tag)}>, not <spirit:component>")
    return _Component(root, str(path)).info()


class _Component:
    """Reads one component element."""

    def __init__(self, root: ElementTree.Element, file: str) -> None:
        self._root = root
        self._file = file
        nodes = [node for node in below(root, "model", "ports", "port") if not _disabled(node, "PORT_ENABLEMENT")]
        self._ports = {port.name: port for port in map(self._port, nodes)}

    def info(self) -> ModuleInfo:
        buses = [
            bus for bus in below(self._root, "busInterfaces", "busInterface") if not _disabled(bus, "BUSIF_ENABLEMENT")
        ]
        interfaces = [self._interface(bus) for bus in buses if not _signal(bus)]
        clocks, resets, irqs = [], [], []
        for bus in buses:
            port = next(iter(_port_map(bus).values()), None)
            if port is None or not _signal(bus):
                continue
            found = self._ports.get(port, Port(port, PortDirection.UNKNOWN, None))
            name, stated = text_of(bus, "name"), _bus_parameters(bus)
            if _signal(bus) == "clock":
                clock = clock_of(name, found, stated)
                clocks.append(replace(clock, reset=next(iter(clock.resets), None)))
            elif _signal(bus) == "reset":
                resets.append(Reset(name, port, polarity_of(stated), found.direction))
            else:
                sense = stated.get("SENSITIVITY", "")
                irqs.append(Interrupt(name, port, _mode(bus), found.width, sense))
        done = associate(interfaces, clocks, resets, self._file)
        used = {port for interface in interfaces for port in interface.ports.values()}
        used |= {clock.port for clock in clocks} | {reset.port for reset in resets} | {irq.port for irq in irqs}
        return ModuleInfo(
            name=self._model_name(),
            file=self._file,
            language=Language.IPXACT,
            parameters=tuple(map(_parameter, below(self._root, "model", "modelParameters", "modelParameter"))),
            ports=tuple(self._ports.values()),
            interfaces=done.interfaces,
            clocks=done.clocks,
            resets=done.resets,
            interrupts=tuple(irqs),
            leftovers=tuple(Leftover(name, _LEFT_OVER) for name in self._ports if name not in used),
            problems=done.problems,
        )

    def _model_name(self) -> str:
        for wanted in ("synthesis", ""):
            for view in descendants(self._root, "view"):
                name = text_of(view, "modelName")
                if name and wanted in text_of(view, "envIdentifier"):
                    return name
        return text_of(self._root, "name")

    def _port(self, node: ElementTree.Element) -> Port:
        wire = next(children(node, "wire"), node)
        width: int | None = 1
        text = ""
        for vector in descendants(wire, "vector"):
            left, right = text_of(vector, "left"), text_of(vector, "right")
            high, low = number(left), number(right)
            width, text = None if high is None or low is None else abs(high - low) + 1, f"[{left}:{right}]"
        kind = next((text_of(child, "typeName") for child in descendants(wire, "wireTypeDef")), "")
        direction = PortDirection(text_of(wire, "direction"))
        return Port(text_of(node, "name"), direction, width, self._file, range=text, type=kind)

    def _interface(self, bus: ElementTree.Element) -> Interface:
        kind = _bus_type(bus)
        vlnv = ":".join(kind.get(key, "") for key in ("vendor", "library", "name", "version"))
        ports = {signal: self._ports[port] for signal, port in _port_map(bus).items() if port in self._ports}
        protocol = make_protocol(kind.get("name", ""), [], vlnv=vlnv)
        return make_interface(text_of(bus, "name"), protocol, _mode(bus), ports, FoundBy.IPXACT, _bus_parameters(bus))


def _parameter(node: ElementTree.Element) -> Parameter:
    text = text_of(node, "value")
    value = number(text)
    return Parameter(text_of(node, "name"), text if value is None else value, text)


def _signal(bus: ElementTree.Element) -> str:
    """clock, reset or interrupt, for what is no bus."""
    kind = _bus_type(bus)
    return kind["name"] if kind.get("library") == "signal" and kind.get("name") in _SIGNALS else ""


def _bus_type(bus: ElementTree.Element) -> dict[str, str]:
    found = next(children(bus, "busType"), None)
    return {local(key): value for key, value in found.attrib.items()} if found is not None else {}


def _mode(bus: ElementTree.Element) -> Mode:
    return next((_MODES[local(child.tag)] for child in bus if local(child.tag) in _MODES), Mode.SLAVE)


def _port_map(bus: ElementTree.Element) -> dict[str, str]:
    found = {}
    for node in bus.iter():
        if local(node.tag) == "portMap":
            logical = next((text_of(child, "name") for child in children(node, "logicalPort")), "")
            physical = next((text_of(child, "name") for child in children(node, "physicalPort")), "")
            if logical and physical:
                found[logical.upper()] = physical
    return found


def _bus_parameters(bus: ElementTree.Element) -> dict[str, str]:
    """The interface's parameters."""
    nodes = below(bus, "parameters", "parameter")
    return {text_of(node, "name").upper(): text_of(node, "value") for node in nodes}


def _disabled(node: ElementTree.Element, what: str) -> bool:
    """Whether the component's parameters disable a port or interface, so that the HDL's instance does not have it.

    Parameters of an interface have an enablement too, but that one says whether they may be changed.
    """
    for child in node.iter():
        if local(child.tag) == "isEnabled" and (child.text or "").strip() == "false":
            named = next((value for key, value in child.attrib.items() if local(key) == "id"), what)
            if named.startswith(what):
                return True
    return False


def number(text: str) -> int | None:
    """``16``, ``0x10``, ``'h10`` or ``"0000"``; None for a name, or an expression that was not resolved."""
    text = re.sub(r"^.*'h", "0x", text.strip('"'))
    try:
        return int(text, 0)
    except ValueError:
        return int(text) if text.isascii() and text.isdigit() and len(text) < 20 else None


_SOURCES = ("verilogSource", "systemVerilogSource", "vhdlSource")


@dataclass(slots=True)
class ComponentFiles:
    """Files in order; VHDL that belongs to a named library is listed by library."""

    sources: list[Path] = field(default_factory=list)
    libraries: dict[str, list[Path]] = field(default_factory=dict)
    include_dirs: list[Path] = field(default_factory=list)
    ip: list[Path] = field(default_factory=list)
    constraints: list[Path] = field(default_factory=list)
    tcl: list[Path] = field(default_factory=list)


def component_files(path: Path) -> ComponentFiles:
    """Return the files for synthesis. Raises `HdlError` if one is missing, or if another component is needed."""
    try:
        root = component_root(path.read_bytes())
    except (OSError, ValueError) as error:
        raise HdlError(f"{path}: cannot be read: {error}") from None
    found = ComponentFiles()
    sets = {text_of(node, "name"): node for node in descendants(root, "fileSet")}
    for name in _synthesis(root):
        if name not in sets:
            continue
        for node in descendants(sets[name], "componentRef"):
            other = next((value for key, value in node.attrib.items() if local(key) == "name"), "another component")
            what = f"needs other IP ({other}): make an instance of it in Vivado, and give its .xci"
            raise HdlError(f"{path}: {what}")
        for node in descendants(sets[name], "file"):
            _add(found, path, node)
    return found


def _synthesis(root: ElementTree.Element) -> list[str]:
    """Names of the file sets for synthesis, each once; Verilog's, for a component in both languages."""
    names: dict[str, None] = {}
    kinds = [text_of(view, "envIdentifier") for view in descendants(root, "view")]
    both = any(kind.startswith("verilogSource") and kind.endswith(":synthesis") for kind in kinds)
    for view in descendants(root, "view"):
        kind = text_of(view, "envIdentifier")
        if both and kind.startswith("vhdlSource"):
            continue
        if kind.endswith((":synthesis", "synthesis.constraints")):
            names |= dict.fromkeys(text_of(ref, "localName") for ref in descendants(view, "fileSetRef"))
    return list(names)


def _add(found: ComponentFiles, component: Path, node: ElementTree.Element) -> None:
    path = component.parent / text_of(node, "name")
    kinds = [(child.text or "").strip() for child in node if local(child.tag) in ("fileType", "userFileType")]
    if not path.exists():
        raise HdlError(f"{component}: lists {text_of(node, 'name')}, which is not there")
    if text_of(node, "isIncludeFile") == "true":
        if path.parent not in found.include_dirs:
            found.include_dirs.append(path.parent)
    elif any(kind.startswith(_SOURCES) for kind in kinds):
        library = text_of(node, "logicalName")
        vhdl = any(kind.startswith("vhdl") for kind in kinds)
        named = vhdl and library not in ("", "work", "xil_defaultlib")
        (found.libraries.setdefault(library, []) if named else found.sources).append(path)
    elif path.suffix == ".xci":
        found.ip.append(path)
    elif path.suffix == ".xdc" and not any(kind.startswith("USED_IN_implementation") for kind in kinds):
        found.constraints.append(path)


_SCHEMA = "xilinx.com:schema:json_instance"


def load_xci(path: Path, protocols: Sequence[UserProtocol] = ()) -> ModuleInfo:
    """Read the instance as a module with the ports of its customisation. Raises `HdlError`.

    Older files are XML without ports; use their component.xml, or a module with the same ports, instead.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8", errors="replace"))
        instance = data["ip_inst"]
        if not str(data.get("schema", "")).startswith(_SCHEMA):
            raise ValueError
        name, ports = str(instance["xci_name"]), instance["boundary"]["ports"]
    except OSError as error:
        raise HdlError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError):
        text = "has no list of ports (it is of a Vivado before 2020.2, or its output products were never generated)"
        raise HdlError(f"{path}: {text}: give component: or sim_sources:") from None
    found = tuple(_port(str(port), entries, str(path)) for port, entries in ports.items())
    return detect(ModuleInfo(name, str(path), Language.IPXACT, ports=found), protocols)


def _port(name: str, entries: Any, file: str) -> Port:
    entry = entries[0] if isinstance(entries, list) and entries else {}
    left, right = (str(entry.get(key, "0")) for key in ("size_left", "size_right"))
    width = abs(int(left) - int(right)) + 1 if left.isdigit() and right.isdigit() else None
    text = f"[{left}:{right}]" if "size_left" in entry else ""
    direction = PortDirection(str(entry.get("direction", "")))
    return Port(name, direction, width, file, range=text)

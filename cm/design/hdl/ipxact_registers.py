# SPDX-License-Identifier: Apache-2.0
"""The register map of an IP-XACT component: IEEE 1685-2009 (`spirit`, as Vivado writes), 2014 and 2022."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from xml.etree import ElementTree

from cm.design.errors import BuildError
from cm.design.hdl.ipxact import below, children, component_root, descendants, local, number, text_of
from cm.formats.registers import BlockInfo, Dims, Item, MemoryInfo, RegisterField, RegisterInfo

_Element = ElementTree.Element
_ELSEWHERE = {
    "alternateRegisters": "another view of a register, left out",
    "fieldDefinitionRef": "described elsewhere (typeDefinitions), left out",
    "registerDefinitionRef": "described elsewhere (typeDefinitions), left out",
    "registerFileDefinitionRef": "described elsewhere (typeDefinitions), left out",
    "addressBlockDefinitionRef": "described elsewhere (typeDefinitions), left out",
    "memoryMapDefinitionRef": "described elsewhere (typeDefinitions), left out",
    "enumerationDefinitionRef": "values described elsewhere (typeDefinitions), left out",
    "subspaceMap": "a subspace map, left out",
    "bank": "a bank, whose blocks have no addresses of their own, left out",
    "memoryRemap": "a remap, which holds in some modes only, left out",
}


def ipxact_items(path: Path, bus: str, notes: list[str]) -> list[Item]:
    """The items of all memory maps, or of that of the interface `bus` where the component has several."""
    try:
        root = component_root(path.read_bytes())
    except ValueError as error:
        raise BuildError(f"{path}: not XML: {error}") from None
    if any("xilinx.com" in str(node.tag) for node in root.iter()):  # its `modify` of all fields says nothing
        for node in list(chain(descendants(root, "modifiedWriteValue"), descendants(root, "readAction"))):
            node.text = "" if node.text == "modify" else node.text
    maps = below(root, "memoryMaps", "memoryMap")
    wanted = _map_of(root, bus)
    chosen = [one for one in maps if text_of(one, "name") == wanted] or maps
    found: list[Item] = []
    for one in chosen:
        unit = (number(text_of(one, "addressUnitBits")) or 8) // 8 or 1
        found += chain.from_iterable(_block(node, unit, notes) for node in children(one, "addressBlock"))
        for node in one.iter():
            if why := _ELSEWHERE.get(local(node.tag)):
                notes.append(f"{_name_of(node, one)}: {why}")
    return found


def _name_of(node: _Element, root: _Element) -> str:
    """The name of an element, or of what it stands in."""
    parents = {child: parent for parent in root.iter() for child in parent}
    while not text_of(node, "name") and node in parents:
        node = parents[node]
    return text_of(node, "name")


def _map_of(root: _Element, bus: str) -> str:
    for node in below(root, "busInterfaces", "busInterface"):
        if text_of(node, "name").lower() == bus.lower():
            refs = [value for ref in descendants(node, "memoryMapRef") for key, value in ref.attrib.items()]
            texts = [(ref.text or "").strip() for ref in descendants(node, "memoryMapRef")]
            return next(filter(None, (*refs, *texts)), "")
    return ""


def _block(node: _Element, unit: int, notes: list[str]) -> Iterator[Item]:
    if not _is_present(node) or text_of(node, "usage") == "reserved":
        return
    base, size = _int(node, "baseAddress") * unit, _int(node, "range") * unit
    dims = _dims(node, size, unit)
    if text_of(node, "usage") == "memory":
        width, doc = _int(node, "width") or 32, text_of(node, "description")
        yield MemoryInfo(text_of(node, "name"), base, size, _access(node), width, doc=doc, dims=dims)
        return
    items = tuple(_items(node, unit, _access(node), _int(node, "width"), notes))
    name = f"{text_of(node, 'name')}" if dims else ""
    yield BlockInfo(name, base, items, dims)


def _items(node: _Element, unit: int, access: str, row: int, notes: list[str]) -> Iterator[Item]:
    """What a block or file holds, that is accessed in rows of `row` bits (0: not known)."""
    for child in node:
        if not _is_present(child):
            continue
        kind, offset = local(child.tag), _int(child, "addressOffset") * unit
        if kind == "register":
            yield _register(child, offset, unit, access, row)
        elif kind == "registerFile":
            inside = tuple(_items(child, unit, _access(child) or access, row, notes))
            yield BlockInfo(text_of(child, "name"), offset, inside, _dims(child, _int(child, "range") * unit, unit))


def _register(node: _Element, offset: int, unit: int, access: str, row: int) -> RegisterInfo:
    size = _int(node, "size") or 32
    return RegisterInfo(
        name=text_of(node, "name"),
        offset=offset,
        size=size,
        access=_access(node) or access,
        reset=_reset(node),
        fields=tuple(_field(part) for part in children(node, "field") if _is_present(part)),
        doc=text_of(node, "description"),
        dims=_dims(node, max(-(-size // 8), unit), unit),
        widest=row if row in (8, 16, 32) and row < size else 0,
        volatile=text_of(node, "volatile") == "true",
    )


def _field(node: _Element) -> RegisterField:
    policy = next(iter(below(node, "fieldAccessPolicies", "fieldAccessPolicy")), node)
    values = {
        text_of(one, "name"): value
        for one in below(node, "enumeratedValues", "enumeratedValue")
        if (value := number(text_of(one, "value"))) is not None
    }
    return RegisterField(
        name=text_of(node, "name"),
        lsb=_int(node, "bitOffset"),
        width=_int(node, "bitWidth") or 1,
        access=_access(node),
        write=text_of(policy, "modifiedWriteValue"),
        read=text_of(policy, "readAction"),
        reset=_reset(node),
        values=MappingProxyType(values),
        volatile=text_of(node, "volatile") == "true",
        doc=text_of(node, "description"),
    )


def _access(node: _Element) -> str:
    """An element's access; that of its first policy, since 2022."""
    policies = [below(node, f"{kind}Policies", f"{kind}Policy") for kind in ("access", "fieldAccess")]
    return next(filter(None, (text_of(one, "access") for one in (node, *chain(*policies)))), "")


def _reset(node: _Element) -> int | None:
    """The element's own reset value: of a register in 2009, of a field since 2014."""
    found = [*children(node, "reset"), *below(node, "resets", "reset")]
    return number(text_of(found[0], "value")) if found else None


def _dims(node: _Element, size: int, unit: int) -> Dims:
    """The array's counts with their strides, which only 2022 states; elements follow each other otherwise."""
    arrays = [node, *children(node, "array")]
    counts = [number((one.text or "").strip()) or 1 for array in arrays for one in children(array, "dim")]
    step = next((_int(array, "stride") * unit for array in arrays if text_of(array, "stride")), size)
    found: list[tuple[int, int]] = []
    for count in reversed(counts):
        found.insert(0, (count, step))
        step *= count
    return tuple(found)


def _is_present(node: _Element) -> bool:
    return text_of(node, "isPresent") not in ("0", "false")


def _int(node: _Element, name: str) -> int:
    return number(text_of(node, name)) or 0

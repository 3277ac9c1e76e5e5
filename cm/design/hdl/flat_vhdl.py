# SPDX-License-Identifier: Apache-2.0
"""A flat wrapper around a VHDL entity with record ports: each field of a record becomes a port."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from cm.design.hdl.axi_signals import aximm
from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Sources
from cm.design.hdl.flat_wrappers import IN, OUT, Flat, FlatPort, field_name, unique_ports, wrapper_name
from cm.design.hdl.model import PortDirection
from cm.design.hdl.vhdl import Declaration, VhdlReader
from cm.design.hdl.vhdl_expr import NotFlat, Unknown, Value, base_type, width_of
from cm.design.hdl.vhdl_text import VHDL_SUFFIXES, blank_comments, design_units
from cm.frozen import dataclass

_RECORD = re.compile(r"\btype\s+(\w+)\s+is\s+record\b(.*?)\bend\s+record\b", re.IGNORECASE | re.DOTALL)
_CONTEXT = re.compile(r"\b(?:library\s+[\w\s,]+|use\s+[\w.]+)\s*;", re.IGNORECASE)
_RANGE = re.compile(r"\brange\s+(.+?)\s+(to|downto)\s+(.+)", re.IGNORECASE | re.DOTALL)
_STREAM = frozenset(["valid", "ready", "data", "last", "keep", "strobe", "strb", "user", "id", "dest"])
_SIDE = re.compile(r"(.+)_(?:i|o|in|out|[rw][io])|(?:i|o|in|out)_(.+)", re.IGNORECASE)
_CHANNEL = re.compile(r".*axi.*_(aw|w|b|ar|r|a)(?:_t|_type|_rec)?")
_BITS = ("std_logic", "std_ulogic", "bit")
_MAX_DEPTH = 8

Records = Mapping[str, Sequence[tuple[str, str]]]  # by name in lower case: (field, type)


@dataclass(frozen=True, slots=True)
class _Scope:
    records: Records
    names: Mapping[str, Value | None]
    subtypes: Mapping[str, str]


def flat_vhdl(top: str, wanted: Sources) -> Flat:
    """Return the wrapper of entity `top`. Raises `HdlError` with the reason if none is possible."""
    reader = VhdlReader()
    files = {path: "work" for path in wanted.files if path.suffix.lower() in VHDL_SUFFIXES}
    files |= {path: library for library, paths in wanted.libraries.items() for path in paths}
    texts = {path: path.read_text(encoding="utf-8", errors="replace") for path in files}
    homes = {entity.name.lower(): path for path, text in texts.items() for entity in reader.parse(path, text)}
    home = homes.get(top.lower())
    if home is None:
        raise HdlError(f"no entity {top} in the files given")
    entity = reader.entity(top)
    names, subtypes = reader.scope(top, wanted.parameters)
    subtypes = {name: _bounds(kind, subtypes) for name, kind in subtypes.items()}
    scope = _Scope(dict(_records(map(blank_comments, texts.values()))), names, subtypes)
    ports: list[FlatPort] = []
    records: dict[str, str] = {}
    buses = _buses(entity.ports, scope)
    for port in entity.ports:
        direction = {"in": IN, "out": OUT, "buffer": OUT}.get(port.mode, PortDirection.INOUT)
        if _plain_type(port.type) in scope.records:
            if direction is PortDirection.INOUT:
                message = f"port {port.name} is a bidirectional record: write a wrapper by hand"
                raise HdlError(f"{home}:{port.line}: {message}")
            records[port.name] = port.type
            where = f"{home}:{port.line}: port {port.name}"
            ports += _fields(where, port, direction, buses.get(port.name, port.name), scope)
        else:
            ((_, width, base),) = _leaves(f"{home}:{port.line}: port {port.name}", (), port.type, scope, 0)
            ports.append(FlatPort(port.name, direction, width, "", base, port.default if direction is IN else ""))
    unique_ports(f"{home}: {top}", ports)
    context = _context(blank_comments(texts[home]), top, files[home])
    return Flat(wrapper_name(top), ".vhd", _text(top, wanted, context, files[home], ports, records))


def _records(texts: Iterator[str] | map[str]) -> Iterator[tuple[str, list[tuple[str, str]]]]:
    for text in texts:
        for name, body in _RECORD.findall(text):
            fields = []
            for line in body.split(";"):
                left, colon, kind = line.partition(":")
                fields += [(word.strip(), " ".join(kind.split())) for word in left.split(",") if colon and word.strip()]
            yield name.lower(), fields


def _buses(ports: Iterable[Declaration], scope: _Scope) -> dict[str, str]:
    """Record port → its bus, for records that differ in ``_i`` and ``_o`` only (``_ri``, ``_ro``: its reading half).

    Together they have its signals. Two records with a field in common are two buses, of which ``_i`` and ``_o`` are the
    names.
    """
    halves: dict[str, list[Declaration]] = {}
    for port in ports:
        match = _SIDE.fullmatch(port.name)
        if match and _plain_type(port.type) in scope.records:
            halves.setdefault((match[1] or match[2]).lower(), []).append(port)
    found: dict[str, str] = {}
    for pair in halves.values():
        fields = [path for port in pair for path, _, _ in _leaves(port.name, (), port.type, scope, 0)]
        if {port.mode for port in pair} == {"in", "out"} and len({*fields}) == len(fields):
            match = _SIDE.fullmatch(pair[0].name)
            found |= {port.name: match[1] or match[2] for port in pair if match}
    return found


def _plain_type(kind: str) -> str:
    return kind.partition("(")[0].strip().lower().rpartition(".")[2]


def _fields(where: str, port: Declaration, direction: PortDirection, bus: str, scope: _Scope) -> Iterator[FlatPort]:
    leaves = list(_leaves(where, (), port.type, scope, 0))
    channel = _CHANNEL.fullmatch(_plain_type(port.type))  # one channel of AXI alone is no stream: axi_m2s_w_t
    if (
        channel
        and channel[1] != "a"
        and not any(f"{channel[1]}{path[-1]}".lower() in aximm().spelled for path, *_ in leaves)
    ):
        channel = None  # axi_read_r, where r is for record
    stream = channel is None and all(path[-1].lower() in _STREAM and len(path) == 1 for path, _, _ in leaves)
    for path, width, base in leaves:
        name = field_name(bus, (channel[1], *path) if channel and channel[1] != "a" else path, stream)
        yield FlatPort(name, direction, width, ".".join((port.name, *path)), base)


def _leaves(
    where: str, path: tuple[str, ...], kind: str, scope: _Scope, depth: int
) -> Iterator[tuple[tuple[str, ...], int, str]]:
    name = _plain_type(kind)
    if name in scope.records and depth < _MAX_DEPTH:
        if "(" in kind:
            raise HdlError(f"{where}.{'.'.join(path)} is a record with ranges ({kind}): wrap it by hand")
        for field, inner in scope.records[name]:
            yield from _leaves(where, (*path, field), inner, scope, depth + 1)
        return
    kind, what = _bounds(kind, scope.subtypes), ".".join((where, *path))
    try:
        yield path, width_of(kind, scope.names, scope.subtypes), base_type(kind, scope.subtypes)
    except NotFlat:
        raise HdlError(f"{what} is {kind}, not a vector of bits: wrap it by hand") from None
    except Unknown as error:
        raise HdlError(f"{what} is {kind}: {error}") from None


def _bounds(kind: str, subtypes: Mapping[str, str]) -> str:
    """`kind` with the bounds of ranges in place of ``subtype'high`` and the like."""

    def bound(found: re.Match[str]) -> str:
        given = _RANGE.search(subtypes.get(found[1].lower(), ""))
        if given is None:
            return found[0]
        left, right = (f"({given[n].strip()})" for n in (1, 3))
        low, high = (left, right) if given[2].lower() == "to" else (right, left)
        return {"left": left, "right": right, "low": low, "high": high}[found[2].lower()]

    return re.sub(r"(\w+)'(left|right|low|high)\b", bound, kind, flags=re.IGNORECASE)


def _context(text: str, top: str, library: str) -> list[str]:
    """Return the library and use clauses before the entity, with ``work`` replaced by the library's name."""
    start = next(u.start for u in design_units(text) if u.kind == "entity" and u.name.lower() == top.lower())
    found = [" ".join(clause.split()) for clause in _CONTEXT.findall(text[:start])]
    named = [re.sub(r"\bwork\.", f"{library}.", clause, flags=re.IGNORECASE) for clause in found]
    own = [f"library {library};"] if library != "work" else []
    return list(dict.fromkeys(["library ieee;", "use ieee.std_logic_1164.all;", *own, *named]))


def _text(
    top: str,
    wanted: Sources,
    context: Sequence[str],
    library: str,
    ports: Sequence[FlatPort],
    records: Mapping[str, str],
) -> str:
    declared = [
        f"    {p.name} : {_MODES[p.direction]} {_type(p.width, p.kind)}{_default(p.default)}" for p in ports if p.width
    ]
    assigned = []
    for port in (port for port in ports if port.inner):
        inner = f"record_{port.inner}"
        if port.direction is IN:
            assigned.append(f"  {inner} <= {_convert(port.kind, port.name) if port.width else _NULL};")
        elif port.width:
            assigned.append(f"  {port.name} <= {_back(port.kind, inner)};")
    values = ", ".join(f"{name} => {_value(value)}" for name, value in wanted.parameters.items())
    pins = [_pin(port) for port in ports if not port.inner]
    pins += [f"      {name} => record_{name}" for name in records]
    name = wrapper_name(top)
    lines = [
        "-- SPDX-License-" + "Identifier: Apache-2.0",
        f"-- Generated by cm build: {top} with flat ports in place of its records.",
        *context,
        "",
        f"entity {name} is",
        "  port (",
        ";\n".join(declared),
        "  );",
        "end entity;",
        "",
        f"architecture flat of {name} is",
        *(f"  signal record_{port} : {kind};" for port, kind in records.items()),
        "begin",
        *assigned,
        "",
        f"  inner : entity {library}.{top}",
        *([f"    generic map ({values})"] if values else []),
        "    port map (",
        ",\n".join(pins),
        "    );",
        "end architecture;",
    ]
    return "\n".join(lines) + "\n"


_NULL = '""'  # the value of a null range, which has no bits and is no port of the wrapper
_LITERAL = re.compile(r"'.'|[xob]?\"[^\"]*\"|\bothers\b", re.IGNORECASE)


def _default(text: str) -> str:
    """A default that needs no name: a generic's is known inside only."""
    return f" := {text}" if text and not re.search("[a-z]", _LITERAL.sub("", text), re.IGNORECASE) else ""


def _pin(port: FlatPort) -> str:
    if port.direction is OUT:
        return f"      {_back(port.kind, port.name)} => {port.name}" if port.width else f"      {port.name} => open"
    return f"      {port.name} => {_convert(port.kind, port.name) if port.width else _NULL}"


_MODES = {IN: "in", OUT: "out", PortDirection.INOUT: "inout"}


def _type(width: int, kind: str) -> str:
    return "std_logic" if kind in _BITS else f"std_logic_vector({width - 1} downto 0)"


def _convert(kind: str, name: str) -> str:
    """Convert a flat signal to the field's type."""
    if kind in ("std_logic", "std_ulogic"):
        return name
    if kind in ("unsigned", "signed", "u_unsigned", "u_signed"):
        return f"ieee.numeric_std.{kind}({name})"
    return name if kind == "std_logic_vector" else f"{kind}({name})"


def _back(kind: str, inner: str) -> str:
    return inner if kind in (*_BITS, "std_logic_vector") else f"std_logic_vector({inner})"


def _value(value: str) -> str:
    """Write a generic's value in VHDL: a number, a boolean, or else a string."""
    if value in ("True", "False"):
        return value.lower()
    return value if re.fullmatch(r"[-+]?[\d.]+|'.'|\".*\"", value) else f'"{value}"'

# SPDX-License-Identifier: Apache-2.0
"""Reads VHDL with tree-sitter: entities with evaluated ports and generics, no interfaces yet.

Entities and packages are parsed; the constants and subtypes of packages are visible to all files of one
call. Names are compared regardless of case, and kept as the source spells them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.hdl.errors import WrongParameter
from cm.design.hdl.model import Language, ModuleInfo, Parameter, Polarity, Port, PortDirection, Problem
from cm.design.hdl.usage import Body, vhdl_body
from cm.design.hdl.vhdl_expr import NotFlat, Subtypes, Unknown, Value, evaluate, load_parser, no_value_of, width_of
from cm.design.hdl.vhdl_text import Unit, blank_comments, design_units, instances, signal_attributes
from cm.frozen import dataclass, replace

_INTERFACE_DECLARATIONS = (
    "interface_declaration",
    "interface_signal_declaration",
    "interface_constant_declaration",
    "interface_variable_declaration",
)
_OF_GENERIC = re.compile(r"(\w+)'(range|length)\b", re.IGNORECASE)
_BOUNDS = re.compile(r"\((.+?)\s+(downto|to)\s+(.+)\)", re.IGNORECASE)
_DIRECTIONS = {
    "in": PortDirection.IN,
    "out": PortDirection.OUT,
    "buffer": PortDirection.OUT,
    "inout": PortDirection.INOUT,
}


@dataclass(frozen=True, slots=True)
class Declaration:
    """One name of an interface list, an object or a subtype declaration, as text."""

    name: str
    mode: str
    type: str
    default: str
    line: int


@dataclass(frozen=True, slots=True)
class Entity:
    """An entity as parsed; `attributes` by signal, both in lower case."""

    name: str
    path: Path
    line: int
    generics: tuple[Declaration, ...]
    ports: tuple[Declaration, ...]
    attributes: Mapping[str, Mapping[str, str]]
    instantiates: tuple[str, ...]
    errors: tuple[Problem, ...]
    architectures: tuple[str, ...]


class VhdlReader:
    """Parses each file once, then evaluates the entities asked for."""

    def __init__(self) -> None:
        self._parser = load_parser()
        self._constants: dict[str, Declaration] = {}
        self._subtypes: dict[str, str] = {}
        self._entities: dict[str, Entity] = {}

    def parse(self, path: Path, text: str) -> list[Entity]:
        """Parse one file and keep its entities and packages for `read`."""
        text = blank_comments(text)
        units = list(design_units(text))
        for unit in units:
            if unit.kind == "package":
                self._package(unit, text)
        entities = [self._entity(unit, units, path, text) for unit in units if unit.kind == "entity"]
        for entity in entities:
            self._entities.setdefault(entity.name.lower(), entity)
        return entities

    def _package(self, unit: Unit, text: str) -> None:
        root = self._parser.parse(unit.text.encode()).root_node
        first = _line(text, unit.start)
        for node in _find(root, ("constant_declaration",)):
            for declaration in _declarations(node, first):
                self._constants.setdefault(declaration.name.lower(), declaration)
        for node in _find(root, ("subtype_declaration",)):
            name, _, definition = " ".join(_text(node).rstrip("; \n").split()).partition(" is ")
            self._subtypes.setdefault(name.split()[-1].lower(), definition)

    def _entity(self, unit: Unit, units: Iterable[Unit], path: Path, text: str) -> Entity:
        root = self._parser.parse(unit.text.encode()).root_node
        first = _line(text, unit.start)
        clauses = {node.type: node for node in _find(root, ("generic_clause", "port_clause"))}
        bodies = [other for other in units if other.kind == "architecture" and other.of.lower() == unit.name.lower()]
        return Entity(
            name=unit.name,
            path=path,
            line=first,
            generics=tuple(_interface_list(clauses.get("generic_clause"), first)),
            ports=tuple(_interface_list(clauses.get("port_clause"), first)),
            attributes=_attributes([unit, *bodies]),
            instantiates=tuple(dict.fromkeys(name for body in bodies for name in instances(body.text))),
            errors=tuple(_errors(root, path, first)),
            architectures=tuple(body.text for body in bodies),
        )

    def read(self, names: Iterable[str], parameters: Mapping[str, str] | None = None) -> list[ModuleInfo]:
        """Evaluate the ports of the entities named, with `parameters` set on each of them.

        Raises WrongParameter for a value that the type of its generic does not have.
        """
        constants = self._evaluate_constants()
        wanted = [self._entities[name.lower()] for name in names]
        return [_Evaluation(entity, constants, self._subtypes, parameters or {}).info() for entity in wanted]

    def entity(self, name: str) -> Entity:
        """An entity that was parsed; KeyError if there is none of that name."""
        return self._entities[name.lower()]

    def body(self, name: str) -> tuple[Body, tuple[str, ...]] | None:
        """What an entity does itself, and its ports in lower case; None if it is not known."""
        entity = self._entities.get(name.lower())
        if entity is None:
            return None
        body = vhdl_body("\n".join(entity.architectures).lower())
        resets = tuple((name, self._level(level), clock, at_once) for name, level, clock, at_once in body.resets)
        return replace(body, resets=resets), tuple(port.name.lower() for port in entity.ports)

    def _level(self, level: Polarity | str) -> Polarity | str:
        """A package's constant as the level that it is."""
        known = self._constants.get(level) if isinstance(level, str) else None
        return {"'1'": Polarity.HIGH, "'0'": Polarity.LOW}.get(known.default, level) if known else level

    def scope(self, name: str, parameters: Mapping[str, str]) -> tuple[Mapping[str, Value | None], Subtypes]:
        """Values of constants and of an entity's generics, and subtypes, as its ports see them."""
        evaluation = _Evaluation(self._entities[name.lower()], self._evaluate_constants(), self._subtypes, parameters)
        evaluation.info()
        return evaluation.names, self._subtypes

    def _evaluate_constants(self) -> dict[str, Value | None]:
        """Their values; those of a package may depend on one that comes later among the files."""
        values: dict[str, Value | None] = {}
        todo = dict(self._constants)
        while todo:
            found = {name: value for name, one in todo.items() if (value := _value(one.default, values)) is not None}
            if not found:
                break
            values |= found
            todo = {name: one for name, one in todo.items() if name not in found}
        return values | dict.fromkeys(todo)


class _Evaluation:
    """Values and widths of one entity."""

    def __init__(
        self, entity: Entity, constants: Mapping[str, Value | None], subtypes: Subtypes, given: Mapping[str, str]
    ) -> None:
        self._entity = entity
        self.names: dict[str, Value | None] = dict(constants)  # values of constants and generics
        self._subtypes = subtypes
        self._given = {name.lower(): value for name, value in given.items()}
        self._problems = list(entity.errors)

    def info(self) -> ModuleInfo:
        entity = self._entity
        parameters = tuple(self._generic(generic) for generic in entity.generics)
        ports = tuple(self._port(port) for port in entity.ports)
        return ModuleInfo(
            name=entity.name,
            file=str(entity.path),
            language=Language.VHDL,
            line=entity.line,
            parameters=parameters,
            ports=ports,
            problems=tuple(self._problems),
            instantiates=entity.instantiates,
        )

    def _generic(self, generic: Declaration) -> Parameter:
        given = self._given.get(generic.name.lower())
        value = _value(generic.default if given is None else given, self.names)
        value = given if value is None else value
        if given is not None and value is not None and no_value_of(value, generic.type, self.names, self._subtypes):
            text = f"{generic.name}={given}: the generic {generic.name} of {self._entity.name} is {generic.type}"
            raise WrongParameter(generic.name, text)
        if value is None and (not generic.default or self._needed(generic.name)):
            default = f" := {generic.default}" if generic.default else ""
            hint = f"give it one (parameters:, or -P {generic.name}=…)"
            text = f"generic {generic.name}{default} has no value that could be evaluated: {hint}"
            self._problems.append(Problem(text, str(self._entity.path), generic.line))
        self.names[generic.name.lower()] = value
        return Parameter(generic.name, value, generic.default)

    def _needed(self, generic: str) -> bool:
        """Whether the type of a port, or the default of another generic, has it: one that none has is not asked for."""
        texts = [port.type for port in self._entity.ports]
        texts += [other.default for other in self._entity.generics if other.name != generic]
        return any(re.search(rf"\b{re.escape(generic)}\b", text, re.IGNORECASE) for text in texts)

    def _range(self, found: re.Match[str]) -> str:
        """The bounds of a generic that is a vector, in place of ``G'range``, or ``G'length`` as a number."""
        types = {generic.name.lower(): generic.type for generic in self._entity.generics}
        bounds = _BOUNDS.search(types.get(found[1].lower(), ""))
        value = self.names.get(found[1].lower())
        if found[2].lower() == "length" and isinstance(value, str):
            return str(len(value))
        if bounds is None:
            return found[0]
        high, low = (bounds[1], bounds[3]) if bounds[2].lower() == "downto" else (bounds[3], bounds[1])
        return bounds[0][1:-1] if found[2].lower() == "range" else f"(({high}) - ({low}) + 1)"

    def _port(self, port: Declaration) -> Port:
        flat, width = True, None
        try:
            width = width_of(_OF_GENERIC.sub(self._range, port.type), self.names, self._subtypes)
        except Unknown as error:
            self._problems.append(Problem(f"port {port.name}: {error}", str(self._entity.path), port.line, fatal=True))
            flat = not isinstance(error, NotFlat)
        kind, bracket, inside = port.type.partition("(")
        return Port(
            name=port.name,
            direction=_DIRECTIONS.get(port.mode, PortDirection.UNKNOWN),
            width=width,
            file=str(self._entity.path),
            line=port.line,
            range=(bracket + inside).strip(),
            type=kind.strip(),
            flat=flat,
            attributes=self._entity.attributes.get(port.name.lower(), MappingProxyType({})),
            default=port.default,
        )


def _value(text: str, names: Mapping[str, Value | None]) -> Value | None:
    try:
        return evaluate(text, names) if text else None
    except Unknown:
        return None


def _attributes(units: Iterable[Unit]) -> Mapping[str, Mapping[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for unit in units:
        for signal, attribute, value in signal_attributes(unit.text):
            found.setdefault(signal, {}).setdefault(attribute, value)
    return found


def _interface_list(clause: Any | None, first: int) -> Iterator[Declaration]:
    for node in _find(clause, _INTERFACE_DECLARATIONS) if clause is not None else ():
        yield from _declarations(node, first)


def _declarations(node: Any, first: int) -> Iterator[Declaration]:
    """The names in one `a, b : in T(7 downto 0) := "0"`; comments are already blanked."""
    names, _, rest = _text(node).partition(":")
    left, _, default = rest.rstrip("; \n").partition(":=")
    words = left.split(None, 1)
    mode = words[0].lower() if len(words) > 1 and words[0].lower() in (*_DIRECTIONS, "linkage") else "in"
    kind = words[1] if len(words) > 1 and words[0].lower() in (*_DIRECTIONS, "linkage") else left
    names = re.sub(r"^\s*(signal|constant|shared\s+variable|variable)\s+", "", names, flags=re.IGNORECASE)
    for name in names.split(","):
        if name.strip():
            line = first + node.start_point[0]
            yield Declaration(name.strip(), mode, " ".join(kind.split()), " ".join(default.split()), line)


def _errors(root: Any, path: Path, first: int) -> Iterator[Problem]:
    if not root.has_error:
        return
    node = next(_find(root, ("ERROR",)), root)
    text = " ".join(_text(node).split())[:40]
    yield Problem(f"not understood as VHDL: {text}", str(path), first + node.start_point[0])


def _find(node: Any, kinds: tuple[str, ...]) -> Iterator[Any]:
    """Find nodes of these kinds in order, except those inside another one of them."""
    stack = [node]
    while stack:
        found = stack.pop()
        if found.type in kinds:
            yield found
        else:
            stack.extend(reversed(found.children))


def _text(node: Any) -> str:
    return bytes(node.text).decode(errors="replace")


def _line(text: str, offset: int) -> int:
    return text.count("\n", 0, offset) + 1

# SPDX-License-Identifier: Apache-2.0
"""Converts slang's elaborated instance to `ModuleInfo`: ports and parameters with their values."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.hdl.model import Language, ModuleInfo, Parameter, Port, PortDirection, Problem

_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/|`[^\n]*\n", re.DOTALL)
_RANGE = re.compile(r"\[.*\]", re.DOTALL)
_WORD = re.compile(r"[A-Za-z_]\w*(::\w+)?")
_STRING = re.compile(r'\s*"(.*)"\s*', re.DOTALL)
_PLAIN = ("logic", "reg", "wire", "bit", "signed", "unsigned")
FLAT_WRAPPER = "needs a flat wrapper"


def read_instance(
    compilation: Any,
    sources: Any,
    instance: Any,
    path: Path,
    language: Language,
    errors: tuple[Problem, ...],
    instantiates: tuple[str, ...],
    given: Mapping[str, str],
) -> ModuleInfo:
    """Read one top instance as `ModuleInfo` without interfaces; its problems begin with those of its file."""
    body = instance.body
    problems = list(errors)
    parameters = tuple(_parameters(body, str(path), problems, given))
    asked = len(problems)
    types = {p.name for p in body.parameters if p.kind.name == "TypeParameter"}
    ports = tuple(_Ports(compilation, sources, str(path), types, problems).read(body.portList))
    line = sources.getLineNumber(body.definition.location)
    texts = [port.range for port in ports]
    for one in parameters:  # of those whose default is an array or the like, only what a port needs is asked for
        others = (other.text for other in parameters if other is not one)
        if one.value is None and one.text and not one.local and _names(one.name, (*texts, *others)):
            problems.insert(asked, Problem(_no_value(one.name, one.text), str(path)))
    return ModuleInfo(
        name=body.definition.name,
        file=str(path),
        language=language,
        line=line,
        parameters=parameters,
        ports=ports,
        problems=tuple(problems),
        instantiates=instantiates,
    )


def _parameters(body: Any, file: str, problems: list[Problem], given: Mapping[str, str]) -> Iterator[Parameter]:
    for symbol in body.parameters:
        if symbol.kind.name == "TypeParameter":
            if not symbol.isLocalParam:
                message = f"type parameter {symbol.name}: {FLAT_WRAPPER} that fixes the type"
                problems.append(Problem(message, file, fatal=True))
            yield Parameter(symbol.name, None, local=symbol.isLocalParam)
            continue
        text = _default_text(symbol)
        value = _value(symbol, given.get(symbol.name, text))
        if value is None and not text and not symbol.isLocalParam:
            problems.append(Problem(_no_value(symbol.name, text), file))
        yield Parameter(symbol.name, value, text, symbol.isLocalParam)


def _names(name: str, texts: Iterable[str]) -> bool:
    return any(re.search(rf"\b{re.escape(name)}\b", text) for text in texts)


def _no_value(name: str, text: str) -> str:
    if not text:
        return f"parameter {name} has no default: give it a value (parameters:, or -P {name}=…)"
    return f"parameter {name} = {text} could not be evaluated: give it a value (parameters:, or -P {name}=…)"


def _default_text(symbol: Any) -> str:
    text = _source(symbol.syntax)
    return text.partition("=")[2].strip()


def _value(symbol: Any, text: str) -> int | float | str | None:
    constant = symbol.value
    # An untyped parameter with a string literal is an integer to slang.
    if _STRING.fullmatch(text):
        constant = constant.convertToStr()
    value = constant.value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (str, int)):
        return value
    return _integer(value)


def _integer(value: Any) -> int | None:
    """Convert a slang integer to Python; None if it has unknown bits or is not an integer (an array, a queue)."""
    try:
        return int(value)
    except (TypeError, ValueError, RuntimeError):
        return None


def _source(node: Any) -> str:
    """The source of a node without comments; empty if an included file is not in UTF-8."""
    try:
        return " ".join(_COMMENT.sub(" ", str(node)).split()) if node is not None else ""
    except UnicodeDecodeError:
        return ""


class _Ports:
    """Reads the port list of one instance."""

    def __init__(self, compilation: Any, sources: Any, file: str, types: set[str], problems: list[Problem]) -> None:
        self._compilation = compilation
        self._sources = sources
        self._file = file
        self._types = types
        self._problems = problems

    def read(self, symbols: Any) -> Iterator[Port]:
        for symbol in symbols:
            if symbol.name or symbol.kind.name == "InterfacePort":
                yield self._port(symbol)

    def _port(self, symbol: Any) -> Port:
        line, what = self._sources.getLineNumber(symbol.location), symbol.kind.name
        text, kind = self._declaration(symbol) if what == "Port" else ("", "")
        flat, width = False, None
        types = sorted(set(re.findall(r"\w+", kind)) & self._types) if self._types else []
        if what == "InterfacePort":
            why = f" is a SystemVerilog interface ({_interface_name(symbol)}): {FLAT_WRAPPER}"
        elif what != "Port":
            why = f" joins several signals: {FLAT_WRAPPER}"
        elif types:
            why = f" has the type parameter {', '.join(types)}: {FLAT_WRAPPER}"
        elif symbol.type.isError:
            word = _WORD.match(kind)
            flat = word is None or bool(text) or word.group() in _PLAIN
            declared = f" has the type {kind}, which none of the files given declares, or an interface: {FLAT_WRAPPER}"
            missing = f": its range {text or kind} could not be evaluated (a parameter, macro or package is missing)"
            why = missing if flat else declared
        elif not symbol.type.isIntegral:
            why = f" is not a vector of bits ({symbol.type}): {FLAT_WRAPPER}"
        else:
            flat, width, why = True, symbol.type.bitWidth, ""
        if why:
            self._problems.append(Problem(f"port {symbol.name}{why}", self._file, line, fatal=True))
        return Port(
            name=symbol.name,
            direction=PortDirection(getattr(symbol, "direction", PortDirection.UNKNOWN).name.lower()),
            width=width,
            file=self._file,
            line=line,
            range=text if flat else "",
            type=kind,
            flat=flat,
            attributes=self._attributes(symbol) if flat else MappingProxyType({}),
            default=_source(symbol.initializer.syntax) if flat and symbol.initializer is not None else "",
        )

    def _declaration(self, symbol: Any) -> tuple[str, str]:
        """The range and the type as in the source: "[W-1:0]", "reg"."""
        inner = symbol.internalSymbol
        declared = inner.declaredType if inner is not None else None
        syntax = declared.typeSyntax if declared is not None else None
        text = _source(syntax)
        found = _RANGE.search(text)
        return (found.group() if found else ""), _RANGE.sub("", text).strip()

    def _attributes(self, symbol: Any) -> Mapping[str, str]:
        found: dict[str, str] = {}
        for owner in (symbol, symbol.internalSymbol):
            for attribute in self._compilation.getAttributes(owner) if owner is not None else ():
                value = attribute.value.convertToStr().value
                found.setdefault(attribute.name.lower(), value if isinstance(value, str) else str(attribute.value))
        return MappingProxyType(found)


def _interface_name(symbol: Any) -> str:
    definition = symbol.interfaceDef
    name = definition.name if definition is not None else "any interface"
    return f"{name}.{symbol.modport}" if symbol.modport else name

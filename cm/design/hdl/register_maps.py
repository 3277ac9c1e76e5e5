# SPDX-License-Identifier: Apache-2.0
"""Reads registers from the files of other tools: IP-XACT, .hwh, files of Vitis HLS, SystemRDL."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cm.design.errors import BuildError, MissingTool
from cm.design.hdl.hls_registers import hls_memories, hls_registers, is_hls
from cm.design.hdl.ipxact import component_root, descendants, number, text_of
from cm.schema.model import Access, BitField, Memory, Register

Registers = dict[str, Register]


def read_register_map(path: Path, module: str) -> tuple[Registers, dict[str, Memory]]:
    """Read the registers in `path` according to its suffix, and the arrays that HLS has beside them.

    `module` selects one of several in a .hwh or .rdl file.
    """
    readers: Mapping[str, Callable[[Path, str], Registers]] = {
        ".xml": _ipxact,
        ".hwh": _hwh,
        ".rdl": _systemrdl,
        ".h": _hls,
        ".json": _hls_config,
    }
    reader = _hls if is_hls(path) else readers.get(path.suffix.lower())
    if reader is None:
        raise BuildError(f"{path}: registers are read from {', '.join(readers)} files, and *_s_axi.v or .vhd of HLS")
    found, memories = reader(path, module), hls_memories(path) if is_hls(path) else {}
    if not (found or memories):
        raise BuildError(f"{path} describes no registers")
    return found, memories


def _hls(path: Path, module: str) -> Registers:
    del module  # one file for each bus of a module
    return hls_registers(path)


def _hls_config(path: Path, module: str) -> Registers:
    """The arguments on a module's bus, by top and bundle, as in the config.json beside what HLS wrote."""
    try:
        tops = json.loads(path.read_text(encoding="utf-8"))
        bundles = tops[module] if len(tops) > 1 else next(iter(tops.values()))
        arguments = [(a["name"], int(a["offset"], 0), int(a["size"], 0)) for b in bundles.values() for a in b.values()]
    except (ValueError, KeyError, TypeError, AttributeError, StopIteration, RecursionError) as error:
        raise BuildError(f"{path}: not a config.json of HLS, which has top, bundle and argument: {error!r}") from None
    found: Registers = {}
    for name, offset, size in arguments:
        for at in range(0, size if size <= 8 else 0, 4):  # what is longer is an array, which *_s_axi.v describes
            word = identifier(name) if size <= 4 else f"{identifier(name)}_{at // 4}"
            found[word] = Register(word, 0, offset + at)
    return found


def identifier(name: str) -> str:
    """`name` as a name of the runtime schema: lower case, other characters as underscores."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower()
    return text if text and not text[0].isdigit() else f"r_{text}"


def access_of(word: str, one_to_clear: bool = False) -> Access:
    """Convert IP-XACT's access words."""
    if one_to_clear:
        return Access.W1C
    return {"read-only": Access.RO, "write-only": Access.WO}.get(word, Access.RW)


# IP-XACT -------------------------------------------------------------------------------------


def _ipxact(path: Path, module: str) -> Registers:
    del module  # a component has one set
    data = path.read_bytes()
    try:
        root = component_root(data)
    except ValueError as error:
        raise BuildError(f"{path}: not XML: {error}") from None
    found: Registers = {}
    for block in descendants(root, "addressBlock"):
        base = _number(text_of(block, "baseAddress"))
        for node in descendants(block, "register"):
            spec = _ipxact_register(node, base)
            found[spec.name] = spec
    return found


def _ipxact_register(node: ElementTree.Element, base: int) -> Register:
    fields = {}
    clearing = False
    for part in descendants(node, "field"):
        name = identifier(text_of(part, "name"))
        fields[name] = BitField(name, _number(text_of(part, "bitOffset")), _number(text_of(part, "bitWidth")) or 1)
        clearing = clearing or text_of(part, "modifiedWriteValue") == "oneToClear"
    reset = next((text_of(entry, "value") for entry in descendants(node, "reset")), "")
    return Register(
        name=identifier(text_of(node, "name")),
        base_address=0,
        offset=base + _number(text_of(node, "addressOffset")),
        width=_width(_number(text_of(node, "size")) or 32),
        access=access_of(text_of(node, "access"), clearing),
        reset=_number(reset) if reset else None,
        volatile=text_of(node, "volatile") == "true",
        fields=fields,
        doc=" ".join(text_of(node, "description").split()),
    )


def _number(text: str) -> int:
    return number(text) or 0


def _width(bits: int) -> int:
    """The access width that holds `bits`."""
    return next((width for width in (8, 16, 32, 64) if bits <= width), 64)


# .hwh ----------------------------------------------------------------------------------------


def _hwh(path: Path, module: str) -> Registers:
    from cm.formats.hwh import read  # a reader that only this needs

    design = read(path)
    having = {name: instance for name, instance in design.modules.items() if any(instance.registers.values())}
    chosen = [instance for name, instance in having.items() if module in (name, instance.name, instance.type)]
    if len(chosen) != 1:
        raise BuildError(f"{path}: {module} is not one of the instances with registers: {', '.join(having) or 'none'}")
    return {
        spec.name: spec
        for block in chosen[0].registers.values()
        for spec in (register_of(register) for register in block)
    }


def register_of(register: Any) -> Register:
    """A `cm.formats.hwh.RegisterInfo` as a register of a module."""
    fields = {
        name: BitField(name, part.lsb, part.width, doc=part.doc)
        for part in register.fields
        for name in [identifier(part.name)]
    }
    clearing = any(part.one_to_clear for part in register.fields)
    # Vivado states the bits in use; the AXI peripherals that it describes are accessed by words
    name, width = identifier(register.name), _width(register.size if register.offset % 4 else max(register.size, 32))
    access = access_of(register.access, clearing)
    return Register(name, 0, register.offset, width, access, None, register.reset, fields=fields, doc=register.doc)


# SystemRDL -----------------------------------------------------------------------------------


def _systemrdl(path: Path, module: str) -> Registers:
    try:
        from systemrdl.compiler import RDLCompiler
        from systemrdl.messages import MessagePrinter, RDLCompileError
        from systemrdl.node import RegNode
    except ImportError:
        raise MissingTool("reading SystemRDL needs systemrdl-compiler: pip install 'fpga-cm[build]'") from None
    said: list[str] = []

    class Printer(MessagePrinter):
        """Keeps what the compiler would write to the terminal."""

        def emit_message(self, lines: list[str]) -> None:
            said.extend(re.sub(r"\x1b\[[0-9;]*m", "", line) for line in lines)

    compiler = RDLCompiler(message_printer=Printer())
    try:
        compiler.compile_file(str(path))
        root = compiler.elaborate(module if module in compiler.root.comp_defs else None)
    except RDLCompileError as error:
        raise BuildError(next((line for line in said if ": error: " in line), f"{path}: {error}")) from None
    return {
        spec.name: spec
        for node in root.top.descendants(unroll=True)
        if isinstance(node, RegNode)
        for spec in [_rdl_register(node, root.top)]
    }


def _rdl_register(node: Any, top: Any) -> Register:
    fields = {}
    reset, writable, readable, clearing = 0, False, False, False
    for part in node.fields():
        name = identifier(part.inst_name)
        fields[name] = BitField(name, part.low, part.width, doc=part.get_property("desc") or "")
        value = part.get_property("reset")
        reset |= (value if isinstance(value, int) else 0) << part.low
        writable, readable = writable or part.is_sw_writable, readable or part.is_sw_readable
        clearing = clearing or getattr(part.get_property("onwrite"), "name", "") == "woclr"
    access = Access.W1C if clearing else Access.RW if writable and readable else Access.WO if writable else Access.RO
    name = identifier(node.get_rel_path(top, array_suffix="_{index:d}", hier_separator="_"))
    offset, width = node.absolute_address - top.absolute_address, _width(node.get_property("regwidth"))
    doc = node.get_property("desc") or ""
    return Register(name, 0, offset, width, access, None, reset, fields=fields, doc=doc)

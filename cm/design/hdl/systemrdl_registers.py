# SPDX-License-Identifier: Apache-2.0
"""The register map of a SystemRDL 2.0 file, as its own compiler elaborates it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from types import MappingProxyType
from typing import Any

from cm.design.errors import BuildError, MissingTool
from cm.extras import installing
from cm.formats.registers import Item, MemoryInfo, RegisterField, RegisterInfo

_ACCESS = {(True, True): "read-write", (True, False): "read-only", (False, True): "write-only", (False, False): "none"}
READS = {"rclr": "clear", "rset": "set", "ruser": "modify"}
WRITES = {
    "woset": "oneToSet",
    "woclr": "oneToClear",
    "wot": "oneToToggle",
    "wset": "set",
    "wclr": "clear",
    "wzs": "zeroToSet",
    "wzc": "zeroToClear",
    "wzt": "zeroToToggle",
    "wuser": "modify",
}


def systemrdl_items(path: Path, module: str, notes: list[str]) -> list[Item]:
    """The registers and memories of the address map `module`, or of the last in the file, by paths as names."""
    try:
        from systemrdl.compiler import RDLCompiler
        from systemrdl.messages import MessagePrinter, RDLCompileError
    except ImportError:
        raise MissingTool(f"reading SystemRDL needs systemrdl-compiler: {installing('build')}") from None
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
    return list(_items(root.top, notes))


def _items(top: Any, notes: list[str]) -> Iterator[Item]:
    from systemrdl.node import MemNode, RegNode

    for node in top.descendants(unroll=True):
        name = node.get_rel_path(top, array_suffix="_{index:d}", hier_separator="_")
        at = node.absolute_address - top.absolute_address if isinstance(node, (MemNode, RegNode)) else 0
        if isinstance(node, MemNode):
            width, doc = node.get_property("memwidth"), node.get_property("desc") or ""
            access = node.get_property("sw")
            yield MemoryInfo(name, at, node.size, _ACCESS["r" in access.name, "w" in access.name], width, doc=doc)
        elif isinstance(node, RegNode) and isinstance(node.parent, MemNode):
            notes.append(f"{name}: a register of a memory, which is read and written as a whole")
        elif isinstance(node, RegNode):
            yield _register(node, name, at, notes)


def _register(node: Any, name: str, offset: int, notes: list[str]) -> RegisterInfo:
    widest = node.get_property("accesswidth")
    return RegisterInfo(
        name=name,
        offset=offset,
        size=node.get_property("regwidth"),
        fields=tuple(_field(part, name, notes) for part in node.fields()),
        doc=node.get_property("desc") or "",
        widest=widest if widest < node.get_property("regwidth") else 0,
    )


def _field(part: Any, register: str, notes: list[str]) -> RegisterField:
    reset, encode = part.get_property("reset"), part.get_property("encode")
    if reset is not None and not isinstance(reset, int):
        notes.append(f"{register}.{part.inst_name}: its reset is a signal, so its value is not known")
    access = _ACCESS[part.is_sw_readable, part.is_sw_writable]
    if access == "none":
        notes.append(f"{register}.{part.inst_name}: software neither reads nor writes it")
    pulse = "oneToSet" if part.get_property("singlepulse") else ""  # the hardware clears it in the next clock
    return RegisterField(
        name=part.inst_name,
        lsb=part.low,
        width=part.width,
        access="read-only" if access == "none" else access,
        write=pulse or WRITES.get(getattr(part.get_property("onwrite"), "name", ""), ""),
        read=READS.get(getattr(part.get_property("onread"), "name", ""), ""),
        reset=reset if isinstance(reset, int) else None,
        values=MappingProxyType({item.name: item.value for item in encode} if encode is not None else {}),
        volatile=part.is_hw_writable or part.is_volatile,
        doc=part.get_property("desc") or "",
    )

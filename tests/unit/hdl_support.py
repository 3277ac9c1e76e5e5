# SPDX-License-Identifier: Apache-2.0
"""Helpers of the tests of interface extraction."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cm.design.hdl.extract import Sources, read
from cm.design.hdl.model import ModuleInfo

DATA = Path(__file__).parents[1] / "data" / "hdl"


def extract(files: Iterable[Path], **options: Any) -> list[ModuleInfo]:
    """The modules of these files."""
    return list(read(Sources(list(files), **options)).modules)


def module(path: Path, text: str, name: str = "m.v", **options: Any) -> ModuleInfo:
    """The only module, or `top`, of a text."""
    file = path / name
    file.write_text(text)
    return extract([file], **options)[0]


def ports(path: Path, declarations: str, header: str = "", name: str = "m.v", **options: Any) -> ModuleInfo:
    """A module with these ports, given as "input a; output [7:0] b"."""
    text = ",\n".join(part.strip() for part in declarations.split(";") if part.strip())
    head = f"#({header})" if header else ""
    return module(path, f"module m {head} (\n{text}\n);\nendmodule\n", name, **options)


def lite(prefix: str, mode: str = "slave") -> str:
    """Port declarations of an AXI4-Lite interface; both channels, without PROT."""
    down, up = ("input", "output") if mode == "slave" else ("output", "input")
    low = f"{down} [11:0] {prefix}awaddr; {down} {prefix}awvalid; {up} {prefix}awready; {down} [31:0] {prefix}wdata; "
    low += f"{down} [3:0] {prefix}wstrb; {down} {prefix}wvalid; {up} {prefix}wready; {up} [1:0] {prefix}bresp; "
    low += f"{up} {prefix}bvalid; {down} {prefix}bready; "
    low += f"{down} [11:0] {prefix}araddr; {down} {prefix}arvalid; {up} {prefix}arready; {up} [31:0] {prefix}rdata; "
    return low + f"{up} [1:0] {prefix}rresp; {up} {prefix}rvalid; {down} {prefix}rready; "


def stream(prefix: str, mode: str, width: int = 8, extra: str = "") -> str:
    """Port declarations of an AXI4-Stream with TREADY; `extra` such as "tlast:1 tuser:2"."""
    forward, back = ("input", "output") if mode == "slave" else ("output", "input")
    text = f"{forward} [{width - 1}:0] {prefix}tdata; {forward} {prefix}tvalid; {back} {prefix}tready; "
    for item in extra.split():
        name, bits = item.split(":")
        text += f"{forward} [{int(bits) - 1}:0] {prefix}{name}; "
    return text

# SPDX-License-Identifier: Apache-2.0
"""Verilog → netlist of the device's cells, by yosys; and what its registers and memories are clocked by.

That is the one clock, at its rising edge: nextpnr 0.11 takes all edges for rising ones where it measures paths, and
measures none between clocks. It forgets that a shift register in look-up tables shifts at the falling edge, and puts
flip-flops of both edges into one slice.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.design.errors import BuildError
from cm.design.generate.output_tree import write_whole
from cm.design.openflow.merge import CLOCK
from cm.design.openflow.netlists import ANCHOR, HARNESS
from cm.design.openflow.rewrites import Cell, packable, separate, unchain, wires_of
from cm.design.openflow.routed import last
from cm.design.openflow.rules import check_cells
from cm.design.openflow.steps import run_tool
from cm.design.openflow.tools import Tool

_PINS = {"FD": ("C",), "SRL": ("CLK",), "RAMB": ("CLKARDCLK", "CLKBWRCLK"), "RAM": ("WCLK",), "DSP": ("CLK",)}
_CONSTANTS = frozenset("01xz")


def check_clocks(netlist: dict[str, Any], top: str, what: str) -> None:
    """Raise BuildError where a cell of yosys' netlist has another clock than the design, or its falling edge."""
    module = netlist["modules"][top]
    every = module.get("netnames", {}).items()
    names = {wire: name for name, net in every if not net["hide_name"] for wire in net["bits"]}
    told = [f"{name} ({kind}) {wrong}" for name, kind, wrong in _wrong(module["cells"], names)]
    if told:
        few = ", ".join(told[:3]) + (f" and {len(told) - 3} more" if len(told) > 3 else "")
        raise BuildError(
            f"{what}: {few}: the open tools time nothing but the rising edge of the one clock; use always @(posedge) "
            "of the module's clock port, and an enable in place of a divided or gated clock"
        )


def _wrong(cells: Mapping[str, Cell], names: Mapping[object, str]) -> Iterator[tuple[str, str, str]]:
    """Names of cells, by a wire that they drive where the source has a name for it; their kinds; what is wrong."""
    drivers = {wire: name for name, cell in cells.items() for wire in wires_of(cell, "output")}
    for name, cell in sorted(cells.items()):
        pins = next((pins for kind, pins in _PINS.items() if cell["type"].startswith(kind)), ())
        if last(name).startswith(HARNESS):
            continue
        shown = next((names[wire] for wire in wires_of(cell, "output") if wire in names), name)
        if cell["type"].endswith("_1") or any("1" in cell["parameters"].get(f"IS_{pin}_INVERTED", "") for pin in pins):
            yield shown, cell["type"], "works at the falling edge"
            continue
        wires = {wire for pin in pins for wire in cell["connections"].get(pin, ())} - _CONSTANTS
        other = sorted((wire for wire in wires if last(drivers.get(wire, "")) != CLOCK), key=str)
        if other:
            by = names.get(other[0]) or drivers.get(other[0], "a port")
            yield shown, cell["type"], f"is clocked by {by}"


# Read by nextpnr. The processing system has pins up to 50 tiles from where nextpnr thinks it is, outside the box in
# which a route is first searched for exhaustively: with a wider box, routing takes a sixth of the time.
ROUTER = {"router2/bbMargin/x": "25", "router2/bbMargin/y": "60"}
_PLAIN = re.compile(r"[^\s;\"']+")


@dataclass(frozen=True, slots=True)
class Sources:
    """What is read for a top: Verilog, SystemVerilog, header folders, macros; and whether it has I/O buffers, DSP48."""

    top: str
    verilog: tuple[Path, ...]
    systemverilog: tuple[Path, ...] = ()
    headers: tuple[Path, ...] = ()
    include_dirs: tuple[Path, ...] = ()
    defines: tuple[str, ...] = ()
    pads: bool = False
    dsp: bool = False

    @property
    def files(self) -> tuple[Path, ...]:
        """All files whose contents affect the result."""
        return (*self.verilog, *self.systemverilog, *self.headers)


def script(sources: Sources, out: Path, folder: Path) -> str:
    """The commands for yosys, with paths relative to `folder`, since they become part of names in the netlist."""

    def here(path: Path) -> str:
        return _word(os.path.relpath(path, folder))

    options = [f"-I{here(path)}" for path in sources.include_dirs] + [f"-D{name}" for name in sources.defines]
    lines = []
    for switch, paths in (("", sources.verilog), (" -sv", sources.systemverilog)):
        if paths:
            lines.append(f"read_verilog{switch} {' '.join([*map(_word, options), *map(here, paths)])}")
    lines += [
        "read_verilog -lib +/xilinx/cells_sim.v +/xilinx/cells_xtra.v",
        f"hierarchy -check -top {sources.top}",
        f"setattr -set keep 1 c:*{ANCHOR}* c:*{HARNESS}* t:PS7",
        *_synthesis(sources),
        f"write_json {here(out)}",
    ]
    return "".join(f"{line}\n" for line in lines)


def _synthesis(sources: Sources) -> list[str]:
    """Run synth_xilinx in two halves, with shift registers of fixed length extracted in between.

    Before YosysHQ/yosys pull request 6059, xilinx_srl dropped the clock enable of such a chain, so that it shifted in
    every cycle: only flip-flops with a constant enable may become one. (Those of variable length keep their enable.)
    """
    every = (
        f"synth_xilinx -flatten -abc9 -noclkbuf -arch xc7 -top {sources.top}"
        + ("" if sources.pads else " -noiopad")
        + ("" if sources.dsp else " -nodsp")
    )
    flops = "t:FDRE t:FDRE_1 %u"
    return [
        f"{every} -run begin:map_luts",
        f"select -set enabled {flops} %ci1:+[CE] t:* %d %co1:+[CE] {flops} %i",
        f"xilinx_srl -fixed -minlen 3 {flops} @enabled %d",
        f"{every} -nosrl -run map_luts:",
    ]


def synthesise(yosys: Tool, sources: Sources, out: Path, folder: Path, what: str) -> None:
    """Write the netlist; yosys runs in `folder`. Raises StepFailed, and BuildError for cells not tried yet."""
    raw, commands = out.with_suffix(".raw.json"), out.with_suffix(".ys")
    commands.write_text(script(sources, raw, folder), encoding="utf-8")
    run_tool(yosys, ["-q", "-s", str(commands)], out.with_suffix(".yosys.log"), {}, what, folder)
    netlist = json.loads(raw.read_text("utf-8"))
    check_cells(netlist, sources.top, what, sources.dsp)
    check_clocks(netlist, sources.top, what)
    separate(netlist, sources.top)
    unchain(netlist, sources.top)
    packable(netlist, sources.top)
    if sources.pads:
        netlist["modules"][sources.top]["settings"] = ROUTER
    write_whole(out, json.dumps(netlist).encode())
    raw.unlink()


def _word(item: Path | str) -> str:
    text = str(item)
    if not _PLAIN.fullmatch(text):
        raise BuildError(f"{text!r}: yosys takes no path with spaces, quotes or semicolons")
    return text


def resolved(paths: Sequence[Path]) -> tuple[Path, ...]:
    """Absolute paths, in order, each once."""
    return tuple(dict.fromkeys(path.absolute() for path in paths))

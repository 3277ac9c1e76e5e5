# SPDX-License-Identifier: Apache-2.0
"""Verilog → netlist of the device's cells, by yosys."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.openflow.clocking import check_clocks
from cm.design.openflow.memories import packable
from cm.design.openflow.netlists import ANCHOR, HARNESS
from cm.design.openflow.rules import check_cells
from cm.design.openflow.shifts import separate, unchain
from cm.design.openflow.steps import run_tool, write_whole
from cm.design.openflow.tools import Tool

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
    """Write the netlist; yosys runs in `folder`. Raises OpenStepFailed, and BuildError for cells not tried yet."""
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

# SPDX-License-Identifier: Apache-2.0
"""How long `cm build interfaces` takes beside the parser that it uses, and `cm build check` and `generate` at all.

Figures are processor time of whole processes, imports included; contestants take turns.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from cm.tools.bench.result import Goal, Result
from cm.tools.bench.run import Run

COUNTS = ((81, Goal(3.0)), (1000, Goal(2.5)))
CHECK, GENERATE = Goal(0.35), Goal(0.5)
_FOLDERS = 6  # files of a folder
_PARSER = """
import sys, pyslang, pyslang.ast, pyslang.syntax
sources = pyslang.SourceManager()
compilation = pyslang.ast.Compilation()
for path in sys.argv[1:]:
    compilation.addSyntaxTree(pyslang.syntax.SyntaxTree.fromFile(path, sources))
for instance in compilation.getRoot().topInstances:
    for port in instance.body.portList:
        port.type.bitWidth
"""


def run(bench: Run) -> list[Result]:
    """Measure `build_interfaces_81` and `_1000`, `build_check` and `build_generate`."""
    found = [_interfaces(bench, count, goal) for count, goal in COUNTS]
    schema = Path(__file__).parents[3] / "data/examples/camera/build.yaml"
    out = str(bench.place("generate") / "build")
    for name, goal, words in (("check", CHECK, []), ("generate", GENERATE, ["--out", out])):
        command = [sys.executable, "-m", "cm", "build", name, str(schema), *words]
        times = [_seconds(command) for _ in range(2 if bench.quick else 10)]
        what = f"processor time of cm build {name} of the camera example"
        found.append(Result(f"build_{name}", statistics.median(times), "s", what, goal=goal))
    return found


def _interfaces(bench: Run, count: int, goal: Goal) -> Result:
    files = _files(bench.place("interfaces"), 12 if bench.quick else count)
    ours = [sys.executable, "-m", "cm", "build", "interfaces", *files]
    parser = [sys.executable, "-c", _PARSER, *files]
    for command in (ours, parser):
        _seconds(command)
    times = [(_seconds(ours), _seconds(parser)) for _ in range(2 if bench.quick else 7)]
    own, theirs = (statistics.median(times) for times in zip(*times, strict=True))
    what = (
        f"processor time of cm build interfaces for {count} files in {count // _FOLDERS} folders, and of pyslang alone"
    )
    return Result(f"build_interfaces_{count}", own, "s", what, theirs, own / theirs, goal)


def _seconds(command: Sequence[str]) -> float:
    """Processor time of a process that succeeds."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command[:6])
    return used.ru_utime + used.ru_stime


def _files(folder: Path, count: int) -> list[str]:
    """Modules with registers, two streams and a pipeline, of which a seventh is instantiated by others."""
    found = []
    for number in range(count):
        path = folder / f"part{number // _FOLDERS}" / f"unit{number}.v"
        path.parent.mkdir(exist_ok=True)
        path.write_text(_module(number), encoding="utf-8")
        found.append(str(path))
    return found


def _module(number: int) -> str:
    ports = ["input wire aclk", "input wire aresetn"]
    for channel, width in (("aw", 12), ("ar", 12)):
        ports += [f"input wire [{width - 1}:0] s_axi_{channel}addr", f"input wire s_axi_{channel}valid"]
        ports += [f"output wire s_axi_{channel}ready"]
    ports += ["input wire [31:0] s_axi_wdata", "input wire [3:0] s_axi_wstrb", "input wire s_axi_wvalid"]
    ports += ["output wire s_axi_wready", "output wire [1:0] s_axi_bresp", "output wire s_axi_bvalid"]
    ports += ["input wire s_axi_bready", "output wire [31:0] s_axi_rdata", "output wire [1:0] s_axi_rresp"]
    ports += ["output wire s_axi_rvalid", "input wire s_axi_rready"]
    ports += [f"input wire [{8 * (1 + number % 8) - 1}:0] s_axis_tdata", "input wire s_axis_tvalid, s_axis_tlast"]
    ports += ["output wire s_axis_tready", "output wire m_axis_tvalid, m_axis_tlast", "input wire m_axis_tready"]
    ports += [f"output wire [{8 * (1 + number % 8) - 1}:0] m_axis_tdata"]
    stages = [
        f"    reg [31:0] stage{at};\n    always @(posedge aclk) if (!aresetn) stage{at} <= 32'd0;\n"
        f"        else if (s_axis_tvalid) stage{at} <= stage{at - 1} + (stage{at - 1} >> {at}) ^ 32'd{at * 77};"
        for at in range(1, 24)
    ]
    below = f"    unit{number - 1} inner (.aclk(aclk));" if number % 7 == 1 else ""
    head = f"module unit{number} (\n    " + ",\n    ".join(ports) + "\n);"
    return "\n".join([head, "    wire [31:0] stage0 = s_axis_tdata;", *stages, below, "endmodule", ""])

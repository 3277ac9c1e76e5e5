# SPDX-License-Identifier: Apache-2.0
"""A module that others' tools have placed and routed behaves, by its bits, as its Verilog does."""

from __future__ import annotations

import random
import re
import struct
import subprocess
from pathlib import Path

import pytest
from design import Design
from expected import simulated
from routed import HERE, Routed, as_verilog

from cm.design.debian_packages import PackageTree
from cm.formats.bitstream import device_by_name, to_dma_words
from cm.formats.bitstream.memory import FrameMemory
from cm.formats.xray import Feature, Wires, bits_of, decode, to_bytes, volatile_bits
from cm.simulation.bits import Boundary, FlipFlop, LutMemory, Netlist, extract

pytestmark = pytest.mark.timeout(600)
CYCLES = 1_000_000


@pytest.fixture(scope="module")
def netlist(routed: Routed) -> Netlist:
    decoded = decode(routed.database, routed.frames)
    assert not decoded.unexplained
    return extract(routed.database, Wires(routed.database), decoded.features, routed.boundary)


def test_everything_that_the_module_is_made_of_is_found(netlist: Netlist) -> None:
    assert not netlist.notes
    stores = [cell for cell in netlist.cells if isinstance(cell, FlipFlop)]
    tables = [cell for cell in netlist.cells if isinstance(cell, LutMemory)]
    assert {cell.synchronous for cell in stores} == {True, False}
    assert {cell.value for cell in stores} == {cell.init for cell in stores} == {True, False}
    assert {(cell.shifts, cell.small) for cell in tables} == {(False, True), (True, True), (True, False)}


def test_the_tables_that_nextpnr_made_memories_of_are_what_changes_by_itself(routed: Routed) -> None:
    database = routed.database
    cells = Design(routed.netlist, routed.routes).cells.values()
    placed = {
        (cell.tile, cell.element[0]) for cell in cells if re.match("RAM|SRL", cell.kind) and "LUT" in cell.element
    }
    masks = volatile_bits(database, routed.frames)
    found = set()
    for tile in database.tiles.values():
        for letter in "ABCD" if tile.kind.startswith("CLBLM") else "":
            places = [bits_of(database, Feature(tile.name, f"SLICEM_X0.{letter}LUT.INIT[{bit}]")) for bit in range(64)]
            values = {(masks.get(far) or 0) >> at & 1 for place in places for (far, at), _ in place or []}
            if values == {1}:
                found.add((f"X{tile.x}Y{tile.y}", letter))
            else:
                assert values == {0}
    assert found == placed
    assert len(placed) > 5


def test_a_million_cycles_of_its_bits_as_verilog_equal_those_of_its_own(netlist: Netlist, tmp_path: Path) -> None:
    (tmp_path / "bits.v").write_text(as_verilog(netlist).replace("design@", "bits"))
    (tmp_path / "both.v").write_text("""
module both (input wire clk, output reg wrong, output wire [7:0] seen);
    reg [31:0] noise = 32'h1234_5678;
    wire [7:0] a = noise[31:24] & {&noise[5:3], 7'h7F}, one, two;
    everything rtl (.clk(clk), .a(a), .y(one));
    bits frames (.clk(clk), .a(a), .y(two));
    assign seen = one;
    always @(posedge clk) begin
        noise <= {noise[30:0], noise[31] ^ noise[21] ^ noise[1] ^ noise[0]};
        wrong <= one != two;
    end
endmodule
""")
    (tmp_path / "main.cpp").write_text(f"""
#include "Vboth.h"
#include <cstdio>
int main() {{
    Vboth top;
    long wrong = 0, changes = 0;
    unsigned before = 0;
    for (long cycle = 0; cycle < {CYCLES}; cycle++) {{
        top.clk = 1; top.eval();
        wrong += top.wrong;
        changes += top.seen != before;
        before = top.seen;
        top.clk = 0; top.eval();
    }}
    printf("%ld wrong of {CYCLES}, %ld changes\\n", wrong, changes);
}}
""")
    sources = [*(str(tmp_path / name) for name in ("both.v", "bits.v", "main.cpp")), str(HERE / "hdl/everything.v")]
    command = ["verilator", "--cc", "--exe", "--build", "-O3", "-Wno-fatal", "-Wno-lint", "--top-module", "both"]
    subprocess.run([*command, "--Mdir", str(tmp_path / "v"), *sources], check=True, capture_output=True)
    said = subprocess.run([tmp_path / "v/Vboth"], check=True, capture_output=True, text=True).stdout
    assert said.startswith(f"0 wrong of {CYCLES}")
    changes = re.search(r"(\d+) changes", said)
    assert changes is not None
    assert int(changes[1]) > CYCLES // 2


def test_frames_of_a_full_bitstream_of_others_are_taken_to_their_addresses(
    routed: Routed, packages: PackageTree, tmp_path: Path
) -> None:
    def line(at: int, frame: int) -> str:
        return f"0x{at:08X} " + ",".join(f"0x{word:08X}" for (word,) in struct.iter_unpack(">I", to_bytes(frame)))

    lines = (line(at, frame) for at, frame in routed.frames.items())
    (tmp_path / "frames").write_text("\n".join(sorted(lines)) + "\n")
    part = routed.database.family / routed.database.part
    options = [f"--part_name={part.name}", f"--part_file={part / 'part.yaml'}", f"--frm_file={tmp_path / 'frames'}"]
    command = packages.command("xc7frames2bit", *options, f"--output_file={tmp_path / 'full.bit'}")
    subprocess.run(command, check=True, capture_output=True)
    device = device_by_name("xc7z010")
    assert device is not None
    memory = FrameMemory(device)
    written = memory.load(to_dma_words(tmp_path / "full.bit"))
    assert {at: frame for at, frame in memory.frames.items() if frame} == {
        at: frame for at, frame in routed.frames.items() if frame
    }
    assert len(written) > 5000


def test_what_is_not_the_modules_own_place_is_not_the_module(routed: Routed, netlist: Netlist, tmp_path: Path) -> None:
    """A blanked region gives constants; at the anchors of another static part a module is garbage."""
    blank = extract(routed.database, Wires(routed.database), frozenset(), routed.boundary)
    letters = {"A": "B", "B": "C", "C": "D", "D": "A"}
    inputs = {(tile, site, letters[letter]): name for (tile, site, letter), name in routed.boundary.inputs.items()}
    ends = {name: (tile, site, letters[letter]) for name, (tile, site, letter) in routed.boundary.outputs.items()}
    features = decode(routed.database, routed.frames).features
    other = extract(routed.database, Wires(routed.database), features, Boundary(inputs, ends))
    values = random.Random(3).choices(range(128), k=100)
    nothing, own, elsewhere = simulated(
        tmp_path, [as_verilog(one) for one in (blank, netlist, other)], [False, False, True], values
    )
    assert set(nothing) == {0}
    assert own != elsewhere

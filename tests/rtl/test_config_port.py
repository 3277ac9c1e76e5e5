# SPDX-License-Identifier: Apache-2.0
"""The path to the ICAP: its feeder against a model of the port, and that model against the vendor's.

CM_UNISIM names a folder with the vendor's simulation models (ICAPE2.v, ICAPE3.v, SIM_CONFIGE2.v,
SIM_CONFIGE3.v and glbl.v of Xilinx/XilinxUnisimLibrary); without it the comparison with them is skipped.
CM_CORPUS names a folder with bitstreams of others, which go through the feeder too.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import struct
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest

import cm
from cm.formats.bitstream.assemble import FrameRun, assemble_stream
from cm.formats.bitstream.container import to_dma_words
from cm.formats.bitstream.geometry import FrameAddress
from cm.simulation.rtl import design as rtl_design

HERE = Path(__file__).parent
RTL = Path(cm.__file__).parent / "design/rtl"
HDL = Path(rtl_design.__file__).parent / "hdl"
SYNC = 0xAA995566

pytestmark = pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs iverilog, which is not installed")


def words_of(image: bytes) -> list[int]:
    """The words of a bitstream as its packets define them."""
    return [word for (word,) in struct.iter_unpack("<I", to_dma_words(image))]


def bitstream(device: str) -> list[int]:
    frame = {"xc7z020": 101 * 4, "xczu3eg": 93 * 4}[device]
    data = random.Random(5).randbytes(3 * frame)
    stream = assemble_stream(device, [[FrameRun(FrameAddress(0, 0, 2), data)]])
    return [word for (word,) in struct.iter_unpack(">I", stream)]


def swapped(word: int) -> int:
    return int.from_bytes(bytes(int(f"{byte:08b}"[::-1], 2) for byte in word.to_bytes(4, "big")), "big")


def run(folder: Path, bench: str, sources: Iterable[Path], tops: Sequence[str], **files: Iterable[str]) -> list[str]:
    """The lines that a bench of plain Verilog prints."""
    for name, lines in files.items():
        (folder / f"{name}.hex").write_text("\n".join(lines) + "\n")
    (folder / "bench.v").write_text(bench)
    command = ["iverilog", "-g2012", "-o", "bench.vvp", *(word for top in tops for word in ("-s", top)), "bench.v"]
    built = subprocess.run([*command, *map(str, sources)], cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    done = subprocess.run(["vvp", "bench.vvp"], cwd=folder, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


FEEDER = """\
`timescale 1ns/1ps
module bench;
    reg clk = 0, resetn = 0, valid = 0;
    reg [32:0] words [0:%COUNT%-1];
    integer n = 0, taken = 0, seed = 7;
    wire ready;
    wire [2:0] status;
    wire [31:0] count;
    always #5 clk = ~clk;
    cm_icap #(.ULTRASCALE(%ULTRASCALE%)) dut (.clk(clk), .resetn(resetn), .s_tvalid(valid), .s_tready(ready),
        .s_tdata(words[n][31:0]), .s_tlast(words[n][32]), .status(status), .words(count));
    always @(posedge clk) begin
        if (valid && ready) begin n = n + 1; valid <= 0; end
        if (resetn && n < %COUNT% && (valid == 0 || ready)) valid <= $urandom(seed) % 4 != 0;
        if (!dut.csib %AVAILABLE%) begin $display("word %h", dut.word); taken = taken + 1; end
    end
    %STALL%
    initial begin
        $readmemh("words.hex", words);
        #52 resetn = 1;
        wait (taken == %COUNT%);
        repeat (6) @(posedge clk);
        $display("status %b count %0d synced %b failed %b", status, count, %CORE%.synced, %CORE%.failed);
        $finish;
    end
    initial begin #100000000 $display("hung after %0d", taken); $finish; end
endmodule
"""


def fed(folder: Path, device: str, words: Sequence[int], stalls: bool = False) -> tuple[list[int], str]:
    """The words that reached the port, and what the feeder and the port say in the end."""
    ultrascale = device.startswith("xczu")
    port = "dut.ultrascale.port" if ultrascale else "dut.series7.port"
    stall = f"always @(negedge clk) {port}.stall <= $urandom(seed) % 3 == 0;" if stalls else ""
    bench = FEEDER.replace("%COUNT%", str(len(words))).replace("%ULTRASCALE%", str(int(ultrascale)))
    bench = bench.replace("%CORE%", f"{port}.core").replace("%STALL%", stall)
    bench = bench.replace("%AVAILABLE%", f"&& {port}.AVAIL" if ultrascale else "")
    lines = [f"{(index == len(words) - 1) << 32 | word:09x}" for index, word in enumerate(words)]
    models = [*sorted((HERE / "models").glob("*.v")), RTL / "cm_icap.v"]
    said = run(folder, bench, models, ["bench"], words=lines)
    taken = [int(line.split()[1], 16) for line in said if line.startswith("word ")]
    return taken, said[-1]


def with_crc(words: Sequence[int], change: int) -> list[int]:
    """The first CRC word changed."""
    index = next(i for i, word in enumerate(words) if word == 0x30000001)
    return [word ^ (change if i == index + 1 else 0) for i, word in enumerate(words)]


@pytest.mark.parametrize("device", ["xc7z020", "xczu3eg"])
def test_a_bitstream_reaches_the_port_swapped_and_is_taken(tmp_path: Path, device: str) -> None:
    words = bitstream(device)
    taken, said = fed(tmp_path, device, words)
    assert taken == [swapped(word) for word in words]
    assert said == f"status 001 count {len(words)} synced 0 failed 0"


def test_a_port_that_is_not_available_loses_no_word_and_gets_none_twice(tmp_path: Path) -> None:
    words = bitstream("xczu3eg")
    taken, said = fed(tmp_path, "xczu3eg", words, stalls=True)
    assert taken == [swapped(word) for word in words]
    assert said.startswith("status 001")


@pytest.mark.parametrize("device", ["xc7z020", "xczu3eg"])
def test_a_wrong_crc_is_in_the_status_that_the_driver_reads(tmp_path: Path, device: str) -> None:
    _, said = fed(tmp_path, device, with_crc(bitstream(device), 0x100))
    assert said.startswith("status 011")
    assert said.endswith("failed 1")


@pytest.mark.parametrize("device", ["xc7z020", "xczu3eg"])
def test_a_good_load_after_a_failed_one_shows_no_error(tmp_path: Path, device: str) -> None:
    words = bitstream(device)
    _, said = fed(tmp_path, device, [*with_crc(words, 1), *words])
    assert said.startswith("status 001")


def test_words_that_were_not_word_swapped_never_synchronise_and_the_end_is_reported(tmp_path: Path) -> None:
    words = [int.from_bytes(word.to_bytes(4, "big"), "little") for word in bitstream("xc7z020")]
    _, said = fed(tmp_path, "xc7z020", words)
    assert said.startswith("status 001")  # nothing tells: the port ignores all of it


@pytest.mark.skipif("CM_CORPUS" not in os.environ, reason="needs CM_CORPUS: a folder with bitstreams")
def test_bitstreams_of_others_are_taken_without_an_error(tmp_path: Path) -> None:
    files = sorted(Path(os.environ["CM_CORPUS"]).rglob("*.bit"))
    tried = [path for path in files if path.stat().st_size < 1_000_000][:5]
    assert tried
    for number, path in enumerate(tried):
        image = path.read_bytes()
        folder = tmp_path / str(number)
        folder.mkdir()
        family = "xczu3eg" if b"xczu" in image[:200] or b"xck" in image[:200] else "xc7z020"
        _, said = fed(folder, family, words_of(image))
        assert (path.name, said.split()[1]) == (path.name, "01")


COMPARE = """\
`timescale 1ps/1ps
module bench;
    reg clk = 0, csib = 1, rdwrb = 0;
    reg [31:0] i = 0;
    reg [33:0] words [0:65535];
    wire [31:0] o;
    wire [7:0] status;
    wire synced, failed, aborting, prdone;
    integer n;
    always #5000 clk = ~clk;
    %PRIMITIVE% #(.DEVICE_ID(32'h%IDCODE%)) vendor (.CLK(clk), .CSIB(csib), .RDWRB(rdwrb), .I(i), .O(o));
    cm_config_port #(.IDCODE(32'h%IDCODE%)) own (.clk(clk), .csib(csib), .rdwrb(rdwrb), .i(i), .status(status),
        .synced(synced), .failed(failed), .aborting(aborting), .prdone(prdone));
    initial begin
        $readmemh("words.hex", words);
        wait (vendor.icap_idone);
        #100000;
        for (n = 0; words[n] !== 34'bx; n = n + 1) begin
            @(negedge clk); {csib, rdwrb, i} = words[n];
            @(posedge clk); #3000;
            $display("at %0d vendor %b %b %h own %b %b %h", n, vendor.%CONFIG%.bus_sync_flag[0],
                     vendor.%CONFIG%.crc_err_flag_tot[0], o, synced, failed, aborting ? status : 8'd0);
        end
        $finish;
    end
endmodule
"""


def compared(folder: Path, primitive: str, idcode: int, pins: Sequence[tuple[int, int, int]]) -> list[list[str]]:
    """(sync, error, output) of the vendor's model and of ours after each clock."""
    given = os.environ.get("CM_UNISIM")
    if not given:
        pytest.skip("needs CM_UNISIM: the folder with the vendor's simulation models")
    config = {"ICAPE2": "SIM_CONFIGE2", "ICAPE3": "SIM_CONFIGE3"}[primitive]
    sources = [HDL / "cm_config_port.v"]
    for name in (primitive, config, "glbl"):
        found = next(Path(given).rglob(f"{name}.v"))
        # Icarus Verilog takes no drive strength with a range
        text = re.sub(r"tri \(\w+, \w+\) \[31:0\]", "tri [31:0]", found.read_text(errors="replace"))
        (folder / found.name).write_text(text)
        sources.append(folder / found.name)
    bench = COMPARE.replace("%PRIMITIVE%", primitive).replace("%CONFIG%", f"{config}_INST")
    lines = [f"{csib << 33 | rdwrb << 32 | word:09x}" for csib, rdwrb, word in pins]
    said = run(folder, bench.replace("%IDCODE%", f"{idcode:08x}"), sources, ["bench", "glbl"], words=lines)
    rows = [line.split() for line in said if line.startswith("at ")]
    assert len(rows) == len(pins)
    return [[*row[3:6], *row[7:10]] for row in rows]


def plain(words: Iterable[int]) -> list[tuple[int, int, int]]:
    return [(0, 0, swapped(word)) for word in words]


def idcode_of(words: Sequence[int]) -> int:
    return words[words.index(0x30018001) + 1]


@pytest.mark.parametrize(("primitive", "device"), [("ICAPE2", "xc7z020"), ("ICAPE3", "xczu3eg")])
@pytest.mark.parametrize("kind", ["good", "pauses", "other device", "not swapped"])
def test_sync_and_errors_are_those_of_the_vendors_model(tmp_path: Path, primitive: str, device: str, kind: str) -> None:
    words = bitstream(device)
    idcode = idcode_of(words)
    pins = plain(words)
    if kind == "pauses":
        pins = [pin for index, pin in enumerate(pins) for pin in ([(1, 0, 0xDEADBEEF)] * (index % 5 == 3) + [pin])]
    elif kind == "other device":
        idcode ^= 0x00100000
    elif kind == "not swapped":
        pins = [(0, 0, word) for word in words]
    rows = compared(tmp_path, primitive, idcode, [*pins, *plain([0x20000000] * 8)])
    final = rows[-1]
    assert final[:2] == final[3:5] == ["0", "1" if kind == "other device" else "0"]
    mine = [row[3] for row in rows]
    theirs = [row[0] for row in rows]
    # it leaves sync some clocks later, when the word has come through its pipeline
    assert theirs.count("1") - mine.count("1") in range(9)
    assert ("1" in mine) == ("1" in theirs) == (kind != "not swapped")
    if "1" in mine:
        assert mine.index("1") == theirs.index("1")


@pytest.mark.parametrize(("primitive", "device"), [("ICAPE2", "xc7z020"), ("ICAPE3", "xczu3eg")])
def test_an_abort_shows_the_status_that_the_vendors_model_shows(tmp_path: Path, primitive: str, device: str) -> None:
    words = bitstream(device)
    at = words.index(SYNC) + 10
    pins = [*plain(words[:at]), *[(0, 1, 0)] * 6, *[(1, 0, 0)] * 3]
    rows = compared(tmp_path, primitive, idcode_of(words), pins)
    shown = [(row[2][-2:], row[5]) for row in rows[at : at + 4]]
    assert shown == [("df", "df"), ("cf", "cf"), ("8f", "8f"), ("9f", "9f")]

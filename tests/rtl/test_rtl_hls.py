# SPDX-License-Identifier: Apache-2.0
"""Modules with the traits of what HLS makes, between the channels of a VDMA: `cm serve --sim=rtl` runs them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs, served
from manager_process import until

import cm
from cm import device
from cm.client.errors import RequestFailed
from cm.simulation.rtl.compile import Unit, compile_units
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.main import prepare
from cm.simulation.rtl.tools import find_tools
from cm.simulation.software import Board, SimError

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
HLS = HERE / "hls/build.yaml"
SHAPE = (24, 32, 3)


def curve(picture: np.ndarray) -> np.ndarray:
    """What the module's table holds."""
    return np.round(255 * np.sqrt(picture / 255)).astype(np.uint8)


def pictures(count: int) -> list[np.ndarray]:
    return [np.random.default_rng(seed).integers(0, 256, SHAPE, np.uint8) for seed in range(count)]


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    with served(tmp_path_factory.mktemp("run"), HLS, "hls", "--sim-icap-rate", "0", mode="tone") as connected:
        yield connected


def test_frames_pass_a_vdma_and_a_module_with_a_table_in_a_file(board: cm.Board) -> None:
    """The module takes pixels from TUSER on, and its table is `./tone_curve_rom.dat`, which is beside its source.

    It was started when its registers were set, since its mode says `run: continuous`.
    """
    with board.stream("from_tone", timeout=60) as back, board.writer("to_tone") as out:
        for picture in pictures(3):
            out.write(picture)
            assert np.array_equal(back.read(), curve(picture))


def test_the_modules_interrupt_comes_by_name_with_the_end_of_a_frame(board: cm.Board) -> None:
    (name,) = board.interrupts.names
    with board.stream("from_tone", timeout=60) as back, board.writer("to_tone") as out:
        out.write(pictures(1)[0])
        back.read()
        board.interrupts[name].wait(timeout=60)  # though it came before
    assert board.registers["isr.done"]


def test_what_runs_once_is_started_by_name_again_and_done_is_there_until_it_is_read(board: cm.Board) -> None:
    board.set_mode("single")
    with board.stream("from_tone", timeout=60) as back, board.writer("to_tone") as out:
        for picture in pictures(2):
            out.write(picture)
            assert np.array_equal(back.read(), curve(picture))
            until(lambda: board.registers.read()["isr"] & 1)  # all that can be read, without what reading would clear
            assert (board.registers["ap_ctrl.done"], board.registers["ap_ctrl.done"]) == (1, 0)
            board.registers["ap_ctrl.start"] = 1
    assert board.registers["ap_ctrl.auto_restart"] == 0
    with pytest.raises(RequestFailed, match=r"field 'ap_ctrl\.done' is read-only"):
        board.registers["ap_ctrl.done"] = 1


@pytest.fixture(scope="module")
def below() -> Iterator[Board]:
    """The board without a manager."""
    prepare(HLS)
    with Board(program="cm.simulation.rtl", arguments=["--build", str(HLS), "--icap-rate", "0"]) as running:
        yield running


def load(board: Board, module: str) -> None:
    from cm.formats.bitstream import to_dma_words

    words = to_dma_words((board.root / f"lib/firmware/cm/hls/{module}.bin").read_bytes())
    control = device.Uio.open(0x4000_0000, board.root)
    control.write(0x100, 1)
    with device.Icap.open("cm_icap0", board.root) as icap, icap.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        icap.load(buffer, len(words))
        assert icap.wait(60.0).ok
    control.write(0x100, 0)
    control.close()


def test_a_frame_begins_with_tuser_and_has_its_lines_at_their_strides(below: Board) -> None:
    """What is no frame is dropped, one that is cut short begins anew, lines that are too short or long are errors."""
    lines, line, stride = SHAPE[0], SHAPE[1] * SHAPE[2], 128
    load(below, "unruly")
    with device.AxiDma.open("from_tone", below.root) as back, back.allocate(3 * lines * stride) as target:
        whole = target.array(0, 3 * lines * stride)
        whole[:] = 0xEE
        for frame in range(3):
            back.submit_video(target, lines, line, stride, offset=frame * lines * stride)
        done = [back.wait(60.0) for _ in range(3)]
        seen = whole.reshape(3, lines, stride).copy()
    assert (seen[:, :, line:] == 0xEE).all(), "between lines nothing is written"
    pixels = seen[:, :, :line].reshape(3, *SHAPE)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert [one.status == 0 for one in done] == [False, True, True]
    good = np.stack([rows, columns], axis=-1)
    assert np.array_equal(pixels[1, ..., :2], good)
    assert np.array_equal(pixels[2, ..., :2], good)
    assert np.array_equal(pixels[0, 3, :30, :2], good[3, :30])
    assert np.array_equal(np.delete(pixels[0, ..., :2], 3, axis=0), np.delete(good, 3, axis=0))
    assert [int(pixels[frame, -1, -1, 2]) for frame in range(3)] == [1, 2, 3]


@pytest.mark.parametrize("change", ["a table", "a module"])
def test_what_the_hdl_lacks_is_said_before_anything_runs(
    change: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(HLS.parent, tmp_path / "hls")
    table, curve_ = tmp_path / "hls/hdl/tone_curve_rom.dat", tmp_path / "hls/hdl/tone_curve.v"
    if change == "a table":
        table.unlink()
        wanted = f"there is no file ./{table.name}, which it reads into a memory: not in {table.parent}"
    else:
        text = curve_.read_text()
        curve_.write_text(text[: text.index("(* ram_style")] + "endmodule\n")
        wanted = "module tone: nothing is in tone_curve_rom, so that their outputs would be 0"
    with (
        pytest.raises(SimError),
        Board(program="cm.simulation.rtl", arguments=["--build", str(tmp_path / "hls/build.yaml")]),
    ):
        pass
    assert wanted in capfd.readouterr().err


PRIMITIVES = """
module used(input clk, input reset, input [3:0] at, input data, output first, output second, output both);
    wire quick;
    BUFG buffer (.I(clk), .O(quick));
    FDRE #(.INIT(1'b1)) store (.C(quick), .CE(1'b1), .R(reset), .D(data), .Q(first));
    SRL16E #(.INIT(16'h00ff)) shift (
        .CLK(quick), .CE(1'b1), .D(data), .A0(at[0]), .A1(at[1]), .A2(at[2]), .A3(at[3]), .Q(second)
    );
    LUT2 #(.INIT(4'h8)) table (.I0(first), .I1(second), .O(both));
endmodule
"""


@needs("yosys")
def test_the_vendors_primitives_have_models_where_yosys_is_and_others_are_named(tmp_path: Path) -> None:
    source = tmp_path / "used.v"
    source.write_text(PRIMITIVES.replace(" table ", " product "))
    unit = Unit("module used", "used", (source,))
    assert compile_units(find_tools(), [unit])[0].exists()
    source.write_text(
        PRIMITIVES.replace(" table ", " product ").replace("BUFG buffer", "RAMB36E1 memory (); BUFG buffer")
    )
    with pytest.raises(RtlError, match=r"no HDL is there for BUFG, FDRE, LUT2, RAMB36E1, SRL16E: .*sim_sources"):
        compile_units(find_tools(), [unit])

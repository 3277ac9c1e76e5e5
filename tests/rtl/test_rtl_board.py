# SPDX-License-Identifier: Apache-2.0
"""The simulated board whose regions run the RTL, below the manager: what a board does, and nothing more."""

from __future__ import annotations

import errno
import json
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs

from cm import device
from cm.formats.bitstream import to_dma_words
from cm.simulation.rtl.compile import Watched
from cm.simulation.rtl.main import prepare
from cm.simulation.software import Board, Control

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
LOOP = HERE / "loop/build.yaml"
CONTROL, LEFT, RIGHT = 0x4000_0000, 0x4001_0000, 0x4100_0000
DECOUPLE, STATUS, IDENTITY = 0x100, 0x108, 0x10C
SCRATCH, MISDEED = 0x10, 0x18
PATIENCE = 60.0


class Rig:
    """The board with its registers, its port and its streams."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.root = board.root
        self.control, self.left, self.right = (device.Uio.open(at, self.root) for at in (CONTROL, LEFT, RIGHT))

    def close(self) -> None:
        for uio in (self.control, self.left, self.right):
            uio.close()

    def words(self, name: str) -> bytes:
        return to_dma_words((self.root / f"lib/firmware/cm/loop/{name}.bin").read_bytes())

    def load(self, words: bytes) -> device.IcapCompletion:
        with device.Icap.open("cm_icap0", self.root) as icap, icap.allocate(len(words)) as buffer:
            buffer.array(0, len(words))[:] = bytearray(words)
            icap.load(buffer, len(words))
            return icap.wait(PATIENCE)

    def decouple(self, index: int, cut: bool, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Of a region, and wait until it is so: its clock may be a slower one."""
        self.control.write(DECOUPLE + 0x10 * index, cut)
        for _ in range(1000):
            meanwhile()
            if cut == bool(self.control.read(STATUS + 0x10 * index) & 1) and (
                cut or self.control.read(IDENTITY + 0x10 * index)
            ):
                return
        raise AssertionError("the region was not cut off, or not connected again")

    def change(self, index: int, name: str) -> None:
        """As the manager does it."""
        self.decouple(index, True)
        assert self.load(self.words(name)).ok
        self.decouple(index, False)


@pytest.fixture(scope="module")
def board() -> Iterator[Board]:
    prepare(LOOP)
    with Board(program="cm.simulation.rtl", arguments=["--build", str(LOOP), "--icap-rate", "0"]) as running:
        yield running


@pytest.fixture
def rig(board: Board) -> Iterator[Rig]:
    board.control.reset()
    made = Rig(board)
    made.change(0, "plain")
    made.change(1, "steady")
    yield made
    made.close()


def packet(length: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, length, np.uint8)


def round_trip(rig: Rig, side: str, data: np.ndarray) -> np.ndarray:
    with (
        device.AxiDma.open(f"to_{side}", rig.root) as out,
        device.AxiDma.open(f"from_{side}", rig.root) as back,
        out.allocate(len(data)) as source,
        back.allocate(len(data) + 64) as target,
    ):
        source.array(0, len(data))[:] = data
        back.submit(target)
        out.submit(source, length=len(data))
        done = back.wait(PATIENCE)
        assert done.status == 0
        return target.array(0, done.length).copy()


@pytest.mark.parametrize("length", [1, 3, 4, 5, 1024, 70_001])
def test_bytes_of_any_number_pass_a_region_and_a_change_of_module_changes_them(rig: Rig, length: int) -> None:
    data = packet(length)
    assert np.array_equal(round_trip(rig, "left", data), data)
    rig.change(0, "inverse")
    assert np.array_equal(round_trip(rig, "left", data), 255 - data)
    assert np.array_equal(round_trip(rig, "right", data), data)


def test_registers_live_in_the_module_and_begin_anew_with_it(rig: Rig) -> None:
    rig.left.write(SCRATCH, 0x1234_5678)
    rig.left.write(SCRATCH + 1, 0xAB, 8)
    assert rig.left.read(SCRATCH) == 0x1234_AB78
    assert rig.left.read(SCRATCH + 2, 16) == 0x1234
    rig.change(0, "plain")
    assert rig.left.read(SCRATCH) == 0


def test_a_region_that_is_cut_off_answers_with_a_bus_error_and_nothing_passes(rig: Rig) -> None:
    rig.decouple(0, True)
    with pytest.raises(device.DeviceError) as caught:
        rig.left.read(SCRATCH)
    assert caught.value.errno == errno.EIO
    assert rig.right.read(SCRATCH) == 0  # the other one does
    rig.decouple(0, False)
    assert rig.left.read(SCRATCH) == 0


def test_one_region_streams_on_while_the_other_is_changed(rig: Rig) -> None:
    count, length = 24, 16_384
    with (
        device.AxiDma.open("to_right", rig.root) as out,
        device.AxiDma.open("from_right", rig.root) as back,
        out.allocate(count * length) as source,
        back.allocate(count * length) as target,
    ):
        data = packet(count * length, 7)
        source.array(0, count * length)[:] = data
        for index in range(count):
            back.submit(target, index * length, length, cookie=index)
            out.submit(source, index * length, length, cookie=index)
        for _ in range(3):
            rig.change(0, "inverse")
            rig.change(0, "plain")
        done = [back.wait(PATIENCE) for _ in range(count)]
        assert [(one.cookie, one.status, one.length) for one in done] == [(i, 0, length) for i in range(count)]
        assert np.array_equal(target.array(0, count * length), data)


def garbage_arrives(rig: Rig, cut: bool) -> bool:
    """Whether anything comes out of the region while it is written to and nothing is sent into it."""
    with device.AxiDma.open("from_left", rig.root) as back, back.allocate(4096) as target:
        rig.decouple(0, cut)
        back.submit(target)
        assert rig.load(rig.words("plain")).ok
        came = bool(select.select([back], [], [], 0)[0])
        back.cancel()
        return came


def test_without_decoupling_the_garbage_of_a_load_reaches_memory(rig: Rig) -> None:
    assert garbage_arrives(rig, cut=False)


def test_with_decoupling_none_does(rig: Rig) -> None:
    assert not garbage_arrives(rig, cut=True)


def test_a_damaged_bitstream_leaves_the_region_undefined(rig: Rig) -> None:
    damaged = bytearray(rig.words("plain"))
    damaged[len(damaged) // 2] ^= 1
    rig.decouple(0, True)
    done = rig.load(bytes(damaged))
    assert device.IcapErrors.CRC in done.errors
    with device.AxiDma.open("from_left", rig.root) as back, back.allocate(1 << 20) as target:

        def take() -> None:  # what comes: a beat that waits could not be cut off
            back.completions()
            with suppress(device.DeviceBusy):
                while True:
                    back.submit(target)

        take()
        rig.control.write(DECOUPLE, 0)
        identities = {rig.control.read(IDENTITY) for _ in range(20)}
        rig.decouple(0, True, meanwhile=take)
        back.cancel()
    assert len(identities) > 10  # noise, another at each look
    rig.change(0, "plain")
    assert np.array_equal(round_trip(rig, "left", packet(64)), packet(64))


@pytest.mark.parametrize(
    ("order", "said"), [(1, "$fatal"), (2, "$finish"), (3, "hangs")], ids=["fatal", "finish", "endless loop"]
)
def test_a_module_that_ends_itself_is_gone_and_the_board_is_not(rig: Rig, order: int, said: str) -> None:
    with pytest.raises(device.DeviceError):
        rig.left.write(MISDEED, order)
    stopped = rig.board.control.state()["stopped"]
    assert said in stopped["left"]
    assert "loop.v" in stopped["left"] or order == 3
    assert np.array_equal(round_trip(rig, "right", packet(512)), packet(512))


def test_an_access_that_nothing_answers_is_an_error_until_the_region_is_cut_off(rig: Rig) -> None:
    rig.left.write(MISDEED, 4)
    with pytest.raises(device.DeviceTimeout):
        rig.left.read(SCRATCH)
    rig.change(0, "plain")  # the decoupler answers in its place
    assert rig.left.read(SCRATCH) == 0


def test_an_error_in_the_hdl_is_reported_with_its_line(tmp_path: Path) -> None:
    import shutil

    from cm.simulation.rtl.compile import compile_units
    from cm.simulation.rtl.design import load_rtl_design
    from cm.simulation.rtl.errors import RtlError
    from cm.simulation.rtl.tools import find_tools

    shutil.copytree(LOOP.parent, tmp_path / "loop")
    source = tmp_path / "loop/hdl/loop.v"
    lines = source.read_text().splitlines()
    number = next(index for index, line in enumerate(lines) if "assign s_axis_tready" in line)
    lines[number] = "    assign s_axis_tready = no_such_thing + ;"
    design = load_rtl_design(LOOP, tmp_path / "tree")
    unit = design.modules["left", "plain"]
    source.write_text("\n".join(lines))
    broken = [type(unit)(unit.name, unit.top, (unit.sources[0], *unit.sources[1:-1], source))]
    with pytest.raises(RtlError, match=f"loop.v:{number + 1}:"):
        compile_units(find_tools(), broken)


def test_the_board_of_a_folder_is_served_by_itself(board: Board, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "cm.cli.main", "sim", "--rtl", str(LOOP.parent), "--root", str(tmp_path / "root")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["ready"]
        assert Control(tmp_path / "root").state()["regions"].keys() == {"left", "right"}
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0


@needs("fst2vcd")
def test_a_trace_shows_the_signals_and_what_the_board_did_to_them(tmp_path: Path) -> None:
    prepare(LOOP, Watched(traces=True))
    with Board(program="cm.simulation.rtl", arguments=["--build", str(LOOP), "--icap-rate", "0", "--traces"]) as board:
        rig = Rig(board)
        board.control.trace(tmp_path)
        rig.change(0, "inverse")
        data = packet(64)
        assert np.array_equal(round_trip(rig, "left", data), 255 - data)
        board.control.trace(None)
        rig.close()
    vcd = {path.name: value_changes(path) for path in tmp_path.iterdir()}
    assert vcd.keys() == {"static.fst", "left.fst"}
    marks = [bytes.fromhex(f"{value:064x}").rstrip(b"\0").decode() for value in vcd["static.fst"]["cm_event"]]
    assert [mark for mark in marks if mark] == ["left: cut off", "left: loading", "left: inverse", "left: connected"]
    sent = [value for value in vcd["left.fst"]["m_axis_tdata"] if value]
    assert int.from_bytes((255 - data[:4]).tobytes(), "little") in sent


def value_changes(path: Path) -> dict[str, list[int]]:
    """The values of each signal of the top in their order, by GTKWave's own reader of the format."""
    text = subprocess.run(["fst2vcd", path], check=True, capture_output=True, text=True).stdout
    names: dict[str, str] = {}
    found: dict[str, list[int]] = {}
    for line in text.splitlines():
        parts = line.split()
        if parts[:1] == ["$var"]:
            found.setdefault(names.setdefault(parts[3], parts[4]), [])
        elif line[:1] == "b":
            found[names[parts[1]]].append(int(parts[0][1:].replace("x", "0"), 2))
        elif line[:1] in ("0", "1") and line[1:] in names:
            found[names[line[1:]]].append(int(line[0]))
    return found


def cycles(board: Board) -> int:
    text: str = board.control.state()["rtl"]
    count: int = json.loads(text)["cycles"]["fclk0"]
    return count

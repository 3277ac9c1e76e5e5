# SPDX-License-Identifier: Apache-2.0
"""What a region holds after unusual bitstreams: of other tools, incomplete, for other frames, full."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from sim_support import Dma, Icap, Node, Uio, attribute

from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.container import to_dma_words
from cm.formats.bitstream.geometry import FrameAddress
from cm.formats.bitstream.simulated_module import assemble_module
from cm.schema.model import FrameRange
from cm.simulation.software import Board
from cm.simulation.software.transport import protocol as p

SCHEMA = """\
config:
  name: lab
  device: {device}
  regions:
    left: {{footprint: [{{block_type: 0, row: 2, columns: [4, 6]}}]}}
    right: {{loader: overlay}}
  modules:
    ours: {{region: left, model: edge}}
    theirs: {{region: left, bitstream: vendor.bit}}
    other: {{region: right}}
  modes: {{default: {{modules: [ours]}}}}
  mmio:
    - {{base_address: 0x1000, registers: {{plain: {{offset: 0x0, reset: 7}}}}}}
"""
FULL = """\
config:
  name: whole
  type: full
  modes: {default: {}}
"""
FRAME = 101 * 4


def frames(column: int, value: int = 1, row: int = 2) -> FrameRun:
    return FrameRun(FrameAddress(0, row, column), bytes([value]) * FRAME * 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A schema beside one module's bitstream, as other tools write it: one run over all columns."""
    path = tmp_path_factory.mktemp("lab")
    (path / "lab.yaml").write_text(SCHEMA.format(device="xc7z020"))
    (path / "vendor.bit").write_bytes(assemble("xc7z020", [frames(4, 9)], design="vendor"))
    return path


@pytest.fixture(scope="module")
def started(folder: Path) -> Iterator[Board]:
    with Board([folder], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        yield board


@pytest.fixture
def board(started: Board) -> Board:
    started.control.reset()
    return started


def load(board: Board, bitstream: bytes | Path) -> int:
    with Icap(board.root, "dev/cm_icap0") as icap:
        return icap.load(to_dma_words(bitstream))[0]


def held(board: Board, region: str = "left") -> str | None:
    return board.control.state()["regions"][region]["module"]


def test_a_bitstream_of_ours_fills_the_schemas_footprint(board):
    path = board.root / "lib/firmware/cm/lab/ours.bit"
    assert load(board, path) == 0
    assert held(board) == "ours"


def test_a_bitstream_of_another_tool_is_known_by_its_contents(board, folder):
    assert not (board.root / "lib/firmware/cm/lab/vendor.bit").exists()
    assert load(board, folder / "vendor.bit") == 0
    assert held(board) == "theirs"


def test_unknown_frames_leave_the_region_empty(board):
    load(board, board.root / "lib/firmware/cm/lab/ours.bit")
    assert load(board, assemble("xc7z020", [frames(4, 33)])) == 0
    assert held(board) is None


def test_a_bitstream_for_some_of_the_columns_leaves_the_region_empty(board):
    part = assemble_module("ours", footprint=[FrameRange(0, 2, 4, 5)])
    load(board, board.root / "lib/firmware/cm/lab/ours.bit")
    assert load(board, part) == 0
    assert held(board) is None


def test_frames_outside_all_regions_change_none_and_are_counted(board):
    load(board, board.root / "lib/firmware/cm/lab/ours.bit")
    before = board.control.state()["outside_writes"]
    assert load(board, assemble("xc7z020", [frames(50)])) == 0
    assert held(board) == "ours"
    assert board.control.state()["outside_writes"] == before + 1


def test_a_bitstream_that_touches_a_second_region_ends_the_module_there(board):
    load(board, board.root / "lib/firmware/cm/lab/other.bit")
    assert held(board, "right") == "other"
    astray = assemble("xc7z020", [frames(50), frames(0, row=0)])
    load(board, astray)
    assert held(board, "right") is None


def test_a_module_no_schema_knows_runs_by_its_model_without_registers(board):
    unknown = assemble_module("stranger", model="edge", footprint=[FrameRange(0, 2, 4, 6)])
    assert load(board, unknown) == 0
    assert held(board) == "stranger"


def test_a_region_that_is_loaded_by_overlay_has_its_overlays(board):
    with Node(board.root, "sys/kernel/config/device-tree/overlays/.node") as node:
        node.call(p.OP_MKDIR, b"cm-right")
        path = "sys/kernel/config/device-tree/overlays/cm-right"
        attribute(board.root, f"{path}/dtbo", (board.root / "lib/firmware/cm/lab/other.dtbo").read_bytes())
        assert held(board, "right") == "other"
        node.call(p.OP_RMDIR, b"cm-right")


def test_a_model_of_the_users_runs_and_one_that_fails_gives_garbage(folder, tmp_path, capfd):
    text = SCHEMA.format(device="xc7z020").replace("model: edge", "model: invert").replace(
        "other: {", "other: {model: broken, "
    )  # fmt: skip
    streams = "  streams: {in: {direction: mm2s, region: REGION}, out: {direction: s2mm, region: REGION}}\n"
    (tmp_path / "mine.py").write_text(
        "MODELS = {'invert': lambda frame, registers: 255 - frame, 'broken': lambda frame, registers: 1 / 0}\n"
    )
    for region, module, expected in (("left", "ours", {248}), ("right", "other", None)):
        (tmp_path / "lab.yaml").write_text(text + streams.replace("REGION", region))
        arguments = ["--icap-rate", "0", "--models", str(tmp_path / "mine.py")]
        with Board([tmp_path / "lab.yaml"], arguments=arguments) as board:
            load(board, board.root / f"lib/firmware/cm/lab/{module}.bit")
            with Dma(board.root, "dev/cm_dma/in") as source, Dma(board.root, "dev/cm_dma/out") as sink:
                handle, memory = source.alloc(4096)
                memory[:] = 7
                taken, result = sink.alloc(4096)
                sink.submit(taken, 4096)
                source.submit(handle, 4096)
                assert sink.done()[1] == 4096
                values = set(result.tolist())
                assert values == expected if expected else len(values) > 200
    assert "ZeroDivisionError" in capfd.readouterr().err


def test_a_full_image_is_made_for_a_full_configuration_and_resets_the_board(folder, tmp_path):
    shutil.copy(folder / "lab.yaml", tmp_path)
    (tmp_path / "whole.yaml").write_text(FULL)
    with Board([tmp_path], arguments=["--icap-rate", "0"]) as board, Uio(board.root, "dev/uio0") as uio:
        load(board, board.root / "lib/firmware/cm/lab/ours.bit")
        uio.write(0, 1)
        with Icap(board.root, "dev/cm_icap0") as icap:
            image = to_dma_words(board.root / "lib/firmware/cm/whole/whole.bit")
            assert icap.load(image, flags=p.LOAD_FULL) == (0, 0)
        assert held(board) is None
        assert uio.read(0) == 7


def test_an_ultrascale_device_has_its_own_frames_and_idcode(tmp_path):
    (tmp_path / "lab.yaml").write_text(SCHEMA.format(device="xck26"))
    with Board([tmp_path], arguments=["--icap-rate", "0"]) as board:
        assert load(board, board.root / "lib/firmware/cm/lab/ours.bit") == 0
        assert held(board) == "ours"
        assert load(board, assemble("xc7z020", [frames(4)])) != 0


TWO = """\
config:
  name: prio
  device: xc7z020
  regions:
    pr_0: {footprint: [{block_type: 0, row: 0, columns: [4, 4]}, {block_type: 2, row: 0, columns: [0, 0]}]}
    pr_1: {footprint: [{block_type: 0, row: 0, columns: [9, 9]}, {block_type: 2, row: 0, columns: [0, 0]}]}
  modules:
    first: {region: pr_0, bitstream: first.bit}
    second: {region: pr_1, bitstream: second.bit}
  modes: {default: {modules: [first, second]}}
"""


def test_block_type_2_which_all_partials_of_7_series_write_tells_no_region_from_another(tmp_path):
    """As those of PYNQ-PRIO do: the modules of the other regions stay."""
    (tmp_path / "prio.yaml").write_text(TWO)
    shared = FrameRun(FrameAddress(2, 0, 0), bytes(228 * FRAME))
    for name, column in (("first", 4), ("second", 9)):
        data = assemble("xc7z020", [shared, frames(column, column, row=0)], design=name)
        (tmp_path / f"{name}.bit").write_bytes(data)
    with Board([tmp_path], arguments=["--icap-rate", "0"]) as board:
        for name in ("first", "second"):
            assert load(board, tmp_path / f"{name}.bit") == 0
        assert (held(board, "pr_0"), held(board, "pr_1")) == ("first", "second")

# SPDX-License-Identifier: Apache-2.0
"""Two regions of an XC7Z020 by the open flow: each is loaded by itself, and runs by its own bits."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from manager_process import served
from xray_oracle import frames_read, read_bits

import cm
from cm.client.board import Board, connect
from cm.design.generate.generation import load_design
from cm.design.openflow.job import labels
from cm.design.openflow.layout import Layout, layouts
from cm.design.openflow.merge import left_out, static_features
from cm.design.openflow.place_and_route import Files, read_side
from cm.design.openflow.tools import Tools, fetched
from cm.design.plan.system import System
from cm.formats.bitstream import device_by_name
from cm.formats.bitstream.memory import FrameMemory
from cm.formats.xray import Database, decode, from_bytes, set_bits
from cm.formats.xray.frames import ECC_MASK
from cm.simulation.bits.main import streams_of
from cm.tools.testing.served import Served

pytestmark = pytest.mark.timeout(1500)  # the first of them runs the flow
DEVICE = "xc7z020"
PLAIN, COLOUR = 0x44454641, 0x434F4C4F  # what the modules' Verilog says of itself
FOCUS = 1  # after a reset, by the modules' Verilog


@pytest.fixture(scope="module")
def system(open_pair: Path) -> System:
    return load_design(open_pair / "build.yaml").system


@pytest.fixture(scope="module")
def database(tools: Tools, system: System) -> Database:
    return Database.open(system.project.part, tools.database)


@pytest.fixture(scope="module")
def places(system: System, database: Database) -> dict[str, Layout]:
    return layouts(system, database)


def image(project: Path, name: str) -> Path:
    return project / f"build/bitstreams/{name}.bit"


def bits(frames: dict[int, int]) -> set[tuple[int, int, int]]:
    return {(far, *divmod(at, 32)) for far, frame in frames.items() for at in set_bits(frame & ~ECC_MASK)}


def test_bitread_finds_our_bits_in_the_full_bitstream_and_of_each_partial_only_its_regions(
    open_pair: Path, places: dict[str, Layout], database: Database, tmp_path: Path
) -> None:
    tree = fetched()
    assert tree is not None
    read = frames_read(image(open_pair, "pair_full"), DEVICE)
    full = bits({far: from_bytes(data) for far, data in read.items()})
    assert read_bits(tree, DEVICE, image(open_pair, "pair_full").read_bytes(), tmp_path) == full
    assert len(full) > 40_000
    for module, kind in [(f"{kind}_{side}", kind) for side in places for kind in ("plain", "colour")]:
        columns = places[module.partition("_")[2]].columns
        found = read_bits(tree, DEVICE, image(open_pair, module).read_bytes(), tmp_path)
        assert {far >> 7 for far, _, _ in found} <= columns
        assert (found == {bit for bit in full if bit[0] >> 7 in columns}) == (kind == "plain")
        frames: dict[int, int] = {}
        for far, word, bit in found:
            frames[far] = frames.get(far, 0) | 1 << 32 * word + bit
        assert not decode(database, frames).unexplained


def test_loading_one_region_leaves_the_frames_of_the_other(
    open_pair: Path, system: System, places: dict[str, Layout]
) -> None:
    device = device_by_name(DEVICE)
    assert device is not None
    memory = FrameMemory(device)
    (whole,), partial = streams_of(open_pair / "target/pair", system)
    memory.load(whole)
    before = dict(memory.frames)
    written = memory.load(partial["colour_left"])
    assert {far >> 7 for far in written} == places["left"].columns
    changed = {far for far, frame in memory.frames.items() if frame != before[far]}
    assert changed
    assert not {far >> 7 for far in changed} & places["right"].columns


def test_the_static_part_keeps_the_clock_of_a_column_beside_a_region(
    open_pair: Path, places: dict[str, Layout], database: Database
) -> None:
    """Two columns of interconnect share twelve leaves of the clock; a region that has one of them has six."""
    inside = {name for place in places.values() for name in place.tiles}
    side = read_side(database, Files(open_pair / "build/open", "static"), labels(places.values())[True], static=True)
    features = static_features(database, places.values(), side)
    leaves = {feature for feature in features if feature.tile in inside and feature.name.startswith("HCLK_LEAF")}
    assert leaves
    assert left_out(database, side, features, database.tiles) == []
    told = left_out(database, side, features - leaves, database.tiles)
    assert len(told) == len(leaves)
    assert "is needed, and is left out of the bitstream" in told[0]


def test_a_partial_of_one_region_is_refused_in_the_other(open_pair: Path, tmp_path: Path) -> None:
    folder = tmp_path / "pair"
    shutil.copytree(open_pair / "target/pair", folder)
    (folder / "colour_right.bin").unlink()
    shutil.copy(image(open_pair, "colour_left"), folder / "colour_right.bit")
    data = yaml.safe_load((folder / "pair.yaml").read_text())
    module = data["config"]["modules"]["colour_right"]
    module.pop("sha256")
    module.pop("bitstream", None)
    (folder / "pair.yaml").write_text(yaml.safe_dump(data))
    with served(schemas=folder) as (manager, _), manager.connected() as board:
        board.load("pair", "plain")
        with pytest.raises(cm.CmError) as refused:
            board.load("pair", "right")
        assert refused.value.code == "footprint_outside"


@pytest.fixture(scope="module")
def board(open_pair: Path) -> Iterator[Board]:
    if shutil.which("verilator") is None:
        pytest.skip("needs verilator, which is not installed")
    manager = Served("bits", build=str(open_pair / "build.yaml"))
    try:
        with connect(str(manager.runtime), timeout=60) as connected:
            yield connected
    finally:
        manager.stop()


def test_a_region_keeps_its_state_while_the_other_one_is_loaded(board: Board) -> None:
    registers = board.registers
    board.load("pair", "plain", progress=False)
    assert (registers.ident_left, registers.ident_right) == (PLAIN, PLAIN)
    registers["focus_left"] = 5
    registers["focus_right"] = 7
    assert (registers.focus_left, registers.focus_right) == (5, 7)
    board.load("pair", "mixed", progress=False)
    assert (registers.ident_left, registers.ident_right) == (COLOUR, PLAIN)
    assert (registers.focus_left, registers.focus_right) == (FOCUS, 7)
    registers["focus_left"] = 9
    board.load("pair", "colour", progress=False)
    assert (registers.ident_left, registers.ident_right) == (COLOUR, COLOUR)
    assert (registers.focus_left, registers.focus_right) == (9, FOCUS)

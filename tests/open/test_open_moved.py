# SPDX-License-Identifier: Apache-2.0
"""A module that is moved to another region is the module there: by bitread, and by what its bits do."""

from __future__ import annotations

from pathlib import Path

import pytest
from twins import Built, compare
from xray_oracle import read_bits

from cm.cli.main import main
from cm.design.openflow.tools import fetched
from cm.formats.bitstream.memory import frames_in
from cm.formats.xray.frames import ECC_WORD

pytestmark = pytest.mark.timeout(900)  # the first of them runs the flow
CYCLES = 100_000
RESET = 40  # cycles after which what has no first value in Verilog has one
MODULE = "edge_upper"
UP = 0x400000  # bit of a frame address of the lower half


@pytest.fixture(scope="module")
def moved(open_moved: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("moved") / "edge_lower.bit"
    schema, blank = open_moved / "target/moved/moved.yaml", open_moved / "build/open/blank.bit"
    words = ["--to", "lower", "--config", str(schema), "--blank", str(blank), "--out", str(out)]
    assert main(["bitstream", "relocate", str(open_moved / f"build/bitstreams/{MODULE}.bit"), *words]) == 0
    assert main(["bitstream", "verify", str(out), "--config", str(schema), "--region", "lower"]) == 0
    return out


def test_bitread_finds_the_modules_bits_in_the_other_region_with_the_static_parts_there(
    open_moved: Path, moved: Path, tmp_path: Path
) -> None:
    tree = fetched()
    assert tree is not None

    def read(path: Path) -> set[tuple[int, int, int]]:
        bits = read_bits(tree, "xc7z010", path.read_bytes(), tmp_path)
        return {one for one in bits if one[1] != ECC_WORD or one[2] > 12}

    blank, original, found = (
        read(path)
        for path in (open_moved / "build/open/blank.bit", open_moved / f"build/bitstreams/{MODULE}.bit", moved)
    )
    columns = {far >> 7 for far in frames_in(moved)[1]}
    static = {one for one in blank if one[0] >> 7 in columns}
    module = {(far | UP, word, bit) for far, word, bit in original - blank}
    assert found == static | module
    assert len(module) > 20_000
    upper = {(far | UP, word, bit) for far, word, bit in blank if not far & UP}
    assert static - upper  # the static part is not the same there


def test_the_build_makes_it_once_and_moves_it_as_the_command_does(open_moved: Path, moved: Path) -> None:
    made = open_moved / "build/bitstreams/edge_lower.bit"
    assert made.read_bytes() == moved.read_bytes()
    steps = {path.stem for path in (open_moved / "build/open").rglob("*.key")}  # below, of another static part
    assert {"synth_edge_upper", "place_edge_upper"} <= steps
    assert not {"synth_edge_lower", "place_edge_lower"} & steps


def test_the_first_run_holds_it_in_both_regions(open_moved: Path) -> None:
    folder = open_moved / "build/bitstreams"
    whole = frames_in(folder / "moved_full.bit")[1]
    for name in ("edge_upper", "edge_lower"):
        own = frames_in(folder / f"{name}.bit")[1]
        assert own == {address: whole[address] for address in own}


def test_its_bits_do_in_each_region_what_its_verilog_does_for_a_hundred_thousand_cycles(
    open_moved: Path, tmp_path: Path
) -> None:
    built = Built(open_moved, tmp_path)
    twins = [built.twin("edge_upper"), built.twin("edge_lower")]
    assert not any(twin.netlist.notes for twin in twins)
    results = compare(tmp_path, twins, CYCLES, RESET)
    assert {name: one.wrong for name, one in results.items()} == {"edge_upper": 0, "edge_lower": 0}
    assert all(one.changes > CYCLES // 4 for one in results.values()), results

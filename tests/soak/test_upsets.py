# SPDX-License-Identifier: Apache-2.0
"""Thousands of single bits turn over in two regions: each is found in one pass, none is invented, each is repaired."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import served

import cm
from cm.formats.bitstream import FrameRun, assemble
from cm.formats.bitstream.geometry import decode_far
from cm.formats.bitstream.memory import frames_in
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import RegionCheck

SCHEMA = """
config:
  name: two
  device: xc7z020
  regions:
    left: {footprint: [{block_type: 0, row: 0, columns: [2, 19]}, {block_type: 1, row: 0, columns: [0, 1]}]}
    right: {footprint: [{block_type: 0, row: 33, columns: [2, 19]}]}
  modules: {near: {region: left}, far: {region: right}}
  streams: {seen: {direction: s2mm, region: right, shape: [16, 16], slots: 8}}
  modes: {both: {modules: [near, far]}}
"""
REGIONS = ("left", "right")
SHARE = 16  # one of so many is repaired by loading, the others by writing frames


pytestmark = pytest.mark.timeout(7200)  # ten thousand take a quarter of an hour
Alive = list[tuple[int, int]]  # frame address and bit of what the fabric changes by itself


@pytest.fixture
def two(tmp_path: Path) -> Iterator[tuple[cm.Board, SimBoard, Alive]]:
    (tmp_path / "two.yaml").write_text(SCHEMA)
    with (
        served(schemas=tmp_path / "two.yaml", board=["--icap-rate", "0"]) as (manager, sim),
        manager.connected() as board,
    ):
        alive = masked(sim.root / "lib/firmware/cm/two/near.bit")
        board.load("two", "both")
        yield board, sim, alive


def masked(bitstream: Path) -> Alive:
    """Write the mask of a module: all of block RAM's contents, and the tables of some frames."""
    device, frames = frames_in(bitstream)
    size, alive, runs = 4 * device.family.frame_words, [], []
    for number, far in enumerate(frames):
        contents = decode_far(far, device.family).block_type == 1
        mask = b"\xff" * size if contents else b"\x00\x00\xff\xff" * (size // 4) if number % 50 == 7 else bytes(size)
        runs.append(FrameRun(decode_far(far, device.family), mask + bytes(size)))
        if any(mask):
            alive += [(far, 32 * word + bit) for word in (3, 60) for bit in (0, 9)]
    bitstream.with_suffix(".msk").write_bytes(assemble(device, runs))
    return alive


def found(check: RegionCheck) -> list[tuple[int, int]]:
    return sorted((frame.far, bit) for frame in check.wrong for bit in frame.bits)


def test_every_upset_is_found_in_one_pass_and_repaired_beside_a_stream_that_loses_nothing(
    two: tuple[cm.Board, SimBoard, Alive], request: pytest.FixtureRequest
) -> None:
    """A stream of one region goes on through all of it; block RAM and tables that are memories change all the time.

    Double hits of one frame are among them, and frames with such tables, whose region is loaded again.
    """
    board, sim, alive = two
    tables = {far for far, _ in alive}
    wanted: int = request.config.getoption("--upsets")
    draw = random.Random(33)
    sim.control.pause("seen")
    sequences = []
    hits = 0
    with board.stream("seen", timeout=60, depth=8) as stream:
        while hits < wanted:
            region = draw.choice(REGIONS)
            other = REGIONS[region == "left"]
            sim.control.upset("left", 1, *draw.choice(alive))
            hit = sim.control.upset(region)
            if region == "left" and hit[0][0] in tables and hit[0][1] % 32 < 16:
                continue  # a bit under the mask: nobody can tell it from what the fabric does
            if draw.random() < 0.1:
                hit = sorted(hit + sim.control.upset(region, 1, hit[0][0], hit[0][1] ^ draw.randrange(1, 16)))
            hits += len(hit)
            assert found(board.check_region(region)) == hit
            assert board.check_region(other).verdict == "good"
            loads = region == "left" and any(far in tables for far, _ in hit)
            reload = region == "left" and draw.randrange(SHARE) == 0  # a load of the stream's own region stops it
            mended = board.check_region(region, repair=True, reload=reload)
            assert (mended.verdict, found(mended)) == ("good", hit)
            assert mended.repaired == ("load" if reload or loads else "frames")
            sim.control.step("seen")
            sequences.append(stream.read().sequence)
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
        assert stream.lost == 0
    told = {region.name: region.health for region in board.status.regions}
    assert sum(health.upsets for health in told.values() if health is not None) == hits
    assert all(health is not None and health.wrong_bits == 0 for health in told.values())
    assert all(board.check_region(region).verdict == "good" for region in REGIONS)

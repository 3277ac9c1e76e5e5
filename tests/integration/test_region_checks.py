# SPDX-License-Identifier: Apache-2.0
"""Regions are compared and repaired over the wire, from the command line, and beside streams that go on."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest
from manager_process import Manager, served

import cm
from cm.cli.main import main
from cm.client.core import calls
from cm.client.errors import RequestFailed, RequestInvalid, RequestNotFound
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import CheckRegion
from cm.wire.messages.status import RegionCheck

TWO = """
config:
  name: two
  device: xc7z020
  regions:
    left: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}
    right: {decoupler: {base_address: 0x1000, offset: 0, bit: 1}}
  modules: {near: {region: left}, far: {region: right}}
  mmio:
    - {base_address: 0x2000, region: left, registers: {gain: {offset: 0x1010, default: 1}}}
  streams:
    seen: {direction: s2mm, region: right, shape: [16, 16], slots: 8}
    other: {direction: s2mm, region: left, shape: [16, 16], slots: 8}
  modes: {both: {modules: [near, far]}}
"""
Two = tuple[cm.Board, SimBoard, Manager]


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Manager, SimBoard]]:
    folder = tmp_path_factory.mktemp("two")
    (folder / "two.yaml").write_text(TWO)
    with served(schemas=folder / "two.yaml") as both:
        yield both


@pytest.fixture
def two(started: tuple[Manager, SimBoard]) -> Iterator[Two]:
    manager, sim = started
    sim.control.clear()
    with manager.connected() as board:
        board.load("two", "both", force=True)
        yield board, sim, manager


def test_a_client_is_told_what_is_wrong_and_what_was_repaired(two: Two) -> None:
    board, sim, _ = two
    hits = sim.control.upset("left", 2)
    found = board.check_region("left")
    assert (found.verdict, found.module, found.wrong_bits, found.config_name) == ("wrong", "near", 2, "two")
    assert sorted((frame.far, bit) for frame in found.wrong for bit in frame.bits) == sorted(hits)
    mended = board.check_region("left", repair=True)
    assert (mended.verdict, mended.repaired, mended.change) == ("good", "frames", board.status.last_change)
    health = next(region.health for region in board.status.regions if region.name == "left")
    assert health is not None
    assert (health.wrong_bits, health.repairs >= 1, health.upsets >= 2) == (0, True, True)


def test_no_frame_of_another_regions_stream_is_lost_by_either_way_of_repair(two: Two) -> None:
    board, sim, _ = two
    sim.control.pause("seen")
    with board.stream("seen", timeout=60, depth=8) as stream:
        sequences = []
        for reload in (False, True, False, True):
            sim.control.upset("left")
            sim.control.step("seen", 2)
            assert board.check_region("left", repair=True, reload=reload).repaired == ("load" if reload else "frames")
            sim.control.step("seen", 2)
            sequences += [stream.read().sequence for _ in range(4)]
        assert sequences == list(range(sequences[0], sequences[0] + 16))
        assert stream.lost == 0
    sim.control.resume("seen")


def test_the_regions_own_stream_goes_on_where_frames_are_written_anew(two: Two) -> None:
    board, sim, _ = two
    sim.control.pause("other")
    with board.stream("other", timeout=60, depth=8) as stream:
        sim.control.step("other")
        first = stream.read().sequence
        sim.control.upset("left")
        assert board.check_region("left", repair=True).repaired == "frames"
        sim.control.step("other")
        assert stream.read().sequence == first + 1
    sim.control.resume("other")


def test_what_cannot_be_done_is_said(two: Two) -> None:
    board, sim, _ = two
    with pytest.raises(RequestNotFound, match="no region 'lefd'; did you mean 'left'"):
        board.check_region("lefd")
    with pytest.raises(RequestNotFound):
        board.check_region("lefd", repair=True)
    sim.control.inject("icap_write_only")
    for repair in (False, True):
        with pytest.raises(RequestFailed, match="can be written but not read") as refused:
            board.check_region("left", repair=repair)
        assert refused.value.code == "no_readback"
    with pytest.raises(RequestInvalid, match="goes with repair"):
        board.ask(calls.Call(CheckRegion("left", reload=True), lambda reply: calls._body(reply, RegionCheck)))


def test_the_command_says_what_wrong_bits_are_part_of_where_a_database_knows(
    two: Two, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, sim, manager = two
    monkeypatch.setattr("cm.formats.xray.Database.open", lambda part: part)
    monkeypatch.setattr("cm.formats.xray.describe_bits", lambda part, bits: dict.fromkeys(bits, f"INT of {part}"))
    place = ["--runtime-dir", str(manager.runtime)]
    sim.control.upset("left", 2)
    assert main(["region", "check", "left", *place]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[1].endswith("PART OF")
    rows = [line for line in shown if line.startswith("0x")]
    assert rows
    assert all(row.endswith("INT of xc7z020") for row in rows)
    assert main(["region", "check", "left", "--repair", "--json", *place]) == 0
    wrong = json.loads(capsys.readouterr().out)["wrong"]
    assert [frame["places"] for frame in wrong] == [["INT of xc7z020"] * len(frame["bits"]) for frame in wrong]


def test_the_command_says_what_it_found_and_its_exit_status_too(two: Two, capsys: pytest.CaptureFixture[str]) -> None:
    _, sim, manager = two
    place = ["--runtime-dir", str(manager.runtime)]
    assert main(["region", "check", "left", *place]) == 0
    ((far, bit),) = sim.control.upset("left")
    assert main(["region", "check", "left", *place]) == 1
    assert main(["status", *place]) == 0
    shown = capsys.readouterr().out
    assert "upsets found" in shown
    assert "left: 1 bits are wrong by the check at " in shown
    main(["region", "map", "left", *place])
    assert "1 of them wrong by the check " in capsys.readouterr().out
    assert main(["region", "map", "left", "--check", "--json", *place]) == 0
    drawn = json.loads(capsys.readouterr().out)
    assert (drawn["region"], drawn["module"], drawn["wrong"]) == ("left", "near", [far])
    assert main(["region", "map", "left", "--svg", "-", *place]) == 0
    assert f"frame {far:08X}: " in capsys.readouterr().out
    assert "left (near): 1 bit in 1 frame wrong" in shown
    assert f"0x{far:08x}" in shown
    assert f"{bit // 32}.{bit % 32}" in shown
    assert main(["region", "check", "left", "--repair", "--json", *place]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["verdict"], told["repaired"], told["wrong"][0]["far"]) == ("good", "frames", far)

# SPDX-License-Identifier: Apache-2.0
"""Streams follow the module of their region, even if a mode does not name it, or the stream names no region."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.cli.main import main
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware.models import palettes

ONE_REGION = """
config:
  name: sensor
  modules: [default, colorise]
  streams:
    camera: {direction: s2mm, shape: [48, 64], rate: 100, REGION}
  modes:
    plain: {modules: [default]}
    colour: {modules: [colorise], streams: {camera: {shape: [48, 64, 3]}}}
"""


def test_a_mode_that_does_not_name_a_region_leaves_its_streams_unchanged(board: cm.Board) -> None:
    board.load("camera", "colorise")
    with board.stream("camera", timeout=30) as stream:
        coloured = stream.read()
        board.set_mode("loopback")
        after = stream.read()
        assert (coloured.shape, after.shape) == ((480, 640, 3), (480, 640, 3))
        assert stream.lost == 0
    [camera] = [s for s in board.config().streams if s.name == "camera"]
    assert camera.shape == (480, 640, 3)
    board.set_mode("default")
    assert board.read("camera", timeout=30).shape == (480, 640)


def test_what_a_manager_finds_at_its_start_has_the_streams_of_its_modules(own: tuple[Manager, SimBoard]) -> None:
    manager, _ = own
    with manager.connected() as board:
        board.load("camera", "colorise")
        board.set_mode("loopback")
    manager.stop()
    manager.start()
    with manager.connected() as board:
        assert board.read("camera", timeout=30).shape == (480, 640, 3)


@pytest.fixture
def one_region(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[cm.Board]:
    (tmp_path / "sensor.yaml").write_text(ONE_REGION.replace("REGION", request.param))
    with served(schemas=tmp_path / "sensor.yaml") as (manager, _), manager.connected() as board:
        yield board


@pytest.mark.parametrize("one_region", ["slots: 4", "region: prr0"], indirect=True)
def test_with_one_region_a_stream_goes_through_its_module_whether_it_says_so_or_not(one_region: cm.Board) -> None:
    one_region.load("sensor", "plain")
    grey = one_region.read("camera", timeout=30)
    one_region.set_mode("colour")
    with one_region.stream("camera", timeout=30) as stream:
        coloured = stream.read()
        assert (grey.shape, coloured.shape) == ((48, 64), (48, 64, 3))
        assert {tuple(colour) for colour in np.asarray(coloured).reshape(-1, 3)[:100]} <= {
            tuple(colour) for colour in palettes()[0]
        }


@pytest.mark.parametrize("one_region", ["region: static"], indirect=True)
def test_a_stream_of_the_static_part_passes_the_region_by(one_region: cm.Board) -> None:
    one_region.load("sensor", "colour")
    assert one_region.read("camera", timeout=30).shape == (48 * 64,), "grey bytes, fewer than the mode's shape has"


def test_the_list_tells_how_many_transfers_failed_and_why(
    board: cm.Board, shared: tuple[Manager, SimBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    manager, sim = shared
    place = ["--runtime-dir", str(manager.runtime)]
    with board.stream("camera", timeout=30) as stream:
        stream.read()
        before = _camera(board).errors
        sim.control.inject("dma_error", "camera", count=2)
        until(lambda: _camera(board).errors == before + 2)
        stream.read()
        assert main(["stream", "list", *place]) == 0
        told = capsys.readouterr().out
    assert "ERRORS" in told
    assert "a transfer of 307200 bytes failed: Input/output error" in told
    until(lambda: not _camera(board).open)
    assert main(["stream", "list", "--json", *place]) == 0
    [camera] = [s for s in json.loads(capsys.readouterr().out) if s["name"] == "camera"]
    assert camera["last_error"]["code"] == "transfer_failed", "it stays known when the stream is closed"
    board.load("camera", "default", force=True)
    assert _camera(board).last_error is None


def _camera(board: cm.Board) -> cm.wire.messages.status.StreamStatus:
    return next(s for s in board.status.streams if s.name == "camera")

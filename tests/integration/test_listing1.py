# SPDX-License-Identifier: Apache-2.0
"""The paper's Listing 1, character for character, in the manager on a board derived from it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, short_folder
from reference import sobel

import cm
from cm.simulation.software.hardware.camera import shipped_photos


@pytest.fixture(scope="module")
def listing() -> Iterator[cm.Board]:
    with short_folder() as folder:
        (folder / "schemas").mkdir()
        shutil.copy(REPOSITORY / "tests/data/listing1.yaml", folder / "schemas/camera.yaml")
        manager = Manager(folder / "run", "--sim", "--config", str(folder / "schemas")).start()
        try:
            with manager.connected() as board:
                board.load("camera")
                yield board
        finally:
            manager.stop()


def flat(array: np.ndarray) -> np.ndarray:
    return array.reshape(-1)


def test_its_modes_and_register_work(listing: cm.Board) -> None:
    listing.mode = "edge_detection"
    assert listing.mode == "edge_detection"
    assert listing.registers["focus"] == 1
    listing.registers["focus"] = 2
    assert listing.registers["focus"] == 2


def test_the_boards_channels_are_its_streams(listing: cm.Board, tmp_path: Path) -> None:
    listing.mode = "default"
    listing.mode = "edge_detection"  # the register is at its default again
    with listing.stream("camera", timeout=60) as stream:
        frames = [np.array(frame) for frame in islice(stream, 2)]
    assert any(np.array_equal(frames[0], flat(sobel(photo))) for photo in shipped_photos().values())


def test_data_go_through_its_only_region(listing: cm.Board) -> None:
    listing.mode = "default"
    sent = np.arange(4096, dtype=np.uint32).astype(np.uint8)
    with listing.stream("from_pl", timeout=60) as stream:
        listing.configure_stream("from_pl", enable=True)
        listing.write("to_pl", sent)
        assert np.array_equal(stream.read(), sent)

# SPDX-License-Identifier: Apache-2.0
"""Overlays and the fpga_manager, as far as a board has them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from suite_board import Board

import cm.device as device

NAME = "cm-device-suite"


@pytest.fixture
def dtbo(board: Board) -> bytes:
    if board.overlay is None:
        pytest.skip("no overlay for this board is given")
    return Path(board.overlay).read_bytes()


@pytest.fixture
def overlays(board: Board) -> Iterator[device.Overlays]:
    found = device.Overlays(board.root)
    if not found.available():
        pytest.skip("the board has no overlay interface")
    yield found
    if NAME in found.list():
        found.remove(NAME)


def test_an_overlay_is_there_between_apply_and_remove(overlays: device.Overlays, dtbo: bytes) -> None:
    overlays.apply(NAME, dtbo)
    assert NAME in overlays.list()
    assert overlays.status(NAME) == "applied"
    overlays.remove(NAME)
    assert NAME not in overlays.list()


def test_a_name_is_taken_once(overlays: device.Overlays, dtbo: bytes) -> None:
    overlays.apply(NAME, dtbo)
    with pytest.raises(device.DeviceExists):
        overlays.apply(NAME, dtbo)
    assert overlays.status(NAME) == "applied"


def test_a_damaged_overlay_leaves_nothing(overlays: device.Overlays, dtbo: bytes) -> None:
    with pytest.raises(device.DeviceError):
        overlays.apply(NAME, dtbo[: len(dtbo) // 2])
    assert NAME not in overlays.list()


def test_an_overlay_that_does_not_exist_is_not_found(overlays: device.Overlays) -> None:
    with pytest.raises(device.DeviceNotFound):
        overlays.remove(NAME)
    with pytest.raises(device.DeviceNotFound):
        overlays.status(NAME)


@pytest.fixture
def manager(board: Board) -> device.FpgaManager:
    if not device.list_fpga_managers(board.root):
        pytest.skip("the board has no fpga_manager")
    return device.FpgaManager(0, board.root)


def test_the_fpga_manager_has_a_name_and_a_state(manager: device.FpgaManager) -> None:
    assert manager.name
    assert manager.state


def test_firmware_that_does_not_exist_is_an_error(manager: device.FpgaManager) -> None:
    with pytest.raises(device.DeviceError):
        manager.load("cm-device-suite/none.bin", partial=True)

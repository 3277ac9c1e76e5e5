# SPDX-License-Identifier: Apache-2.0
"""Memory for masters in the PL: what a client gets, and that it is freed with the client."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.simulation.software import Board as SimBoard

MIB = 1 << 20


def memory_used(sim: SimBoard) -> int:
    return int(sim.control.state()["memory"])


@pytest.fixture(scope="module")
def quiet() -> Iterator[tuple[Manager, SimBoard]]:
    """A manager with nothing loaded, so that nothing else takes memory."""
    with served() as both:
        yield both


@pytest.fixture
def manager(quiet: tuple[Manager, SimBoard]) -> Manager:
    return quiet[0]


@pytest.fixture
def sim(quiet: tuple[Manager, SimBoard]) -> SimBoard:
    return quiet[1]


@pytest.fixture
def board(manager: Manager, sim: SimBoard) -> Iterator[cm.Board]:
    """A client, once the memory of earlier clients has been freed."""
    with manager.connected() as connected:
        until(lambda: memory_used(sim) == 0)
        yield connected


def test_every_array_in_it_keeps_memory_and_the_last_gives_it_back(board: cm.Board, sim: SimBoard) -> None:
    before = memory_used(sim)
    array = board.allocate((2, MIB))
    assert memory_used(sim) == before + 2 * MIB
    view = np.asarray(array)[1]
    del array
    gc.collect()
    view[:] = 5
    assert memory_used(sim) == before + 2 * MIB
    del view
    until(lambda: memory_used(sim) == before)


def test_memory_that_was_given_back_is_still_readable_and_another_gets_its_place(board: cm.Board) -> None:
    array = board.allocate(MIB)
    array[:] = 3
    address = array.device_address
    array.free()
    array.free()
    assert int(array[-1]) == 3
    again = until(lambda: [a for a in [board.allocate(MIB)] if a.device_address == address])
    assert int(again[0].sum()) == 0, "memory of before is seen by nobody"


def test_memory_stays_when_its_board_is_closed(manager: Manager) -> None:
    with manager.connected() as board:
        array = board.allocate((16, 16), np.float32)
    array[...] = 2.5
    assert float(array.sum()) == 640.0

# SPDX-License-Identifier: Apache-2.0
"""Memory for masters in the PL: what a client gets, and that it is freed with the client."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.device import DeviceBusy, DeviceNotFound, Icap, Root
from cm.errors import NotFound
from cm.server.devices import device_memory
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


def test_without_a_port_a_channel_that_is_free_gives_memory(sim: SimBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: Any, **__: Any) -> Icap:
        raise DeviceNotFound(2, "no port", "/dev/cm_icap0")

    monkeypatch.setattr("cm.server.devices.Icap.open", missing)
    root = Root.of(sim.root)
    memory = device_memory(5000, root)
    assert (memory.length, os.fstat(memory.fd).st_size) == (8192, 8192)
    assert memory.address % 4096 == 0
    memory.free()
    with pytest.raises((DeviceBusy, NotFound)), _all_open(root):
        device_memory(5000, root)


class _all_open:  # noqa: N801 - used like a function
    """Open every channel of a board."""

    def __init__(self, root: Root) -> None:
        self._channels = [cm.device.AxiDma.open(name, root) for name in cm.device.list_dma(root)]

    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None:
        for channel in self._channels:
            channel.close()


def test_a_board_that_has_neither_gives_none(tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="neither a configuration port nor a DMA channel"):
        device_memory(4096, Root.of(tmp_path))

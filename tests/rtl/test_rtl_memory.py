# SPDX-License-Identifier: Apache-2.0
"""A module that is a master of its own: it reads and writes what the client has allocated."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from conftest import HERE, needs, served

import cm

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
COPIER = HERE / "copier/build.yaml"


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    with served(tmp_path_factory.mktemp("run"), COPIER, "copier") as connected:
        yield connected


def copy(board: cm.Board, source: int, target: int, words: int) -> int:
    """Start it, wait for its interrupt; its state."""
    board.registers.write({"source": source, "target": target, "words": words})
    with board.interrupts["done"].events(60.0) as done:
        board.registers["start"] = 1
        next(done)
    return int(board.registers["state"])


def test_a_kernel_copies_between_arrays_of_the_client(board: cm.Board) -> None:
    source, target = board.allocate(1024, "uint32"), board.allocate(1024, "uint32")
    source[...] = np.random.default_rng(3).integers(0, 1 << 32, 1024, np.uint32)
    assert copy(board, source.device_address, target.device_address, 1000) == 0
    assert np.array_equal(target[:1000], ~source[:1000])
    assert not target[1000:].any()


def test_an_address_without_memory_is_an_error_on_the_bus(board: cm.Board) -> None:
    target = board.allocate(64, "uint32")
    assert copy(board, 0x0F00_0000, target.device_address, 16) == 2

# SPDX-License-Identifier: Apache-2.0
"""One board for all tests here: Debian with systemd, where our packages are installed as the README says."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from beside import Beside, Twins
from board import RELEASE, Board
from vmboard.booted import Booted
from vmboard.pages import documented

# One board for nearly all: what was begun beside it goes on while others are tried.
ORDER = ("installed", "users", "bridges", "service", "beside", "upgrade", "power_cut", "write_protected")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: ORDER.index(item.path.stem.removeprefix("test_")))


@pytest.fixture(scope="session")
def board() -> Iterator[Board]:
    """The board after the commands of the README, given by the user alice in a folder of release artefacts."""
    place = Path(os.environ["CM_VM_PLACE"])
    machine = pickle.loads((place / "machine").read_bytes())
    board = Board(Booted(machine, place), min(machine.forwards), place)
    try:
        board.start()
        board.do("echo 'APT::Get::Assume-Yes \"true\";' >/etc/apt/apt.conf.d/91yes")  # apt asks; its owner says yes
        block = documented("README.md", "cm import archive")
        said = board.do(f"cd {RELEASE} && bash -exs", "alice", given=block)
        (place / "install.log").write_text(said)
        yield board
    finally:
        board.close()


@pytest.fixture(scope="session")
def laptop(board: Board) -> Path:
    """Keys of a client on another machine, made as the documentation says."""
    board.do("bash -exs", "alice", given=documented("docs/install.md", "cm keygen /etc/cm/keys laptop"))
    return board.keys("laptop")


@pytest.fixture(scope="session")
def beside(board: Board) -> Beside:
    """What was begun with the first test that asks for this."""
    return Beside(board)


@pytest.fixture(scope="session")
def twins(board: Board, laptop: Path) -> Iterator[Twins]:
    """Boards that lost their power, and start beside the tests from the first that asks for this."""
    twins = Twins(board, laptop)
    yield twins
    twins.close()

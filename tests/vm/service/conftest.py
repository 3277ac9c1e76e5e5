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

from board import RELEASE, Board, documented
from vmboard.booted import Booted


@pytest.fixture(scope="session")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    """The board after the commands of the README, given by the user alice in a folder of release artefacts."""
    place = Path(os.environ["CM_VM_PLACE"])
    machine = pickle.loads((place / "machine").read_bytes())
    board = Board(Booted(machine, place), min(machine.forwards), tmp_path_factory.mktemp("keys"))
    try:
        board.start()
        board.do("echo 'APT::Get::Assume-Yes \"true\";' >/etc/apt/apt.conf.d/91yes")  # apt asks; its owner says yes
        block = documented("README.md", "cm import archive")
        said = board.do(f"cd {RELEASE} && bash -exs", "alice", given=block)
        (place / "install.log").write_text(said)
        yield board
    finally:
        (place / "journal").write_text(board.run("journalctl -b --no-pager").said)
        board.booted.close()


@pytest.fixture(scope="session")
def laptop(board: Board) -> Path:
    """Keys of a client on another machine, made as the documentation says."""
    board.do("bash -exs", "alice", given=documented("docs/install.md", "cm keygen /etc/cm/keys laptop"))
    return board.keys("laptop")

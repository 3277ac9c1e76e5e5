# SPDX-License-Identifier: Apache-2.0
"""Streams over an AXI DMA without scatter/gather: a short length register, and one that reports no lengths.

Most designs of PYNQ have such an engine (`c_include_sg` 0, 14 bits by default).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.cli.main import main
from cm.device import AxiDma, DeviceError, DmaCaps
from cm.errors import InvalidRequest
from cm.schema.model import Direction, Stream
from cm.server.streams import channel_setup
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import StreamStatus

LONGEST = (1 << 14) - 1


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[Manager, SimBoard]]:
    with served(["--simple-dma", "to_pl", "--simple-dma", "from_pl:14:blind"]) as found:
        yield found


@pytest.fixture
def root(both: tuple[Manager, SimBoard]) -> Path:
    """The board's root, whose channels the manager leaves alone."""
    with both[0].connected() as board:
        for name in ("camera", "to_pl", "from_pl") if board.mode else ():
            board.configure_stream(name, automatic=True, force=True)
        until(lambda: not any(stream.open for stream in board.status.streams), 60)
    return both[1].root


@pytest.fixture
def board(both: tuple[Manager, SimBoard]) -> Iterator[cm.Board]:
    with both[0].connected() as board:
        board.load("camera", "default", force=True)
        board.load("camera", "loopback")
        yield board


def state(board: cm.Board, name: str) -> StreamStatus:
    return next(s for s in board.status.streams if s.name == name)


def test_a_stream_without_a_shape_is_refused_and_told_why(root: Path) -> None:
    with AxiDma.open("from_pl", root) as channel:
        info = channel.info
    stream = Stream("packets", "from_pl", Direction.S2MM)
    with pytest.raises(InvalidRequest, match=r"cannot tell how many bytes arrived.*each of which must end with TLAST"):
        channel_setup.setup(info, stream)
    assert channel_setup.setup(replace(info, caps=DmaCaps.RESIDUE), stream).length == LONGEST


def test_frames_of_a_known_shape_come_one_after_the_other(board: cm.Board) -> None:
    for name in ("to_pl", "from_pl"):
        board.configure_stream(name, shape=(100, 100))
    with board.stream("from_pl", timeout=60) as stream, board.writer("to_pl", timeout=60) as writer:
        for value in range(10):
            writer.write(np.full((100, 100), value, dtype=np.uint8))
            frame = stream.read()
            assert frame.shape == (100, 100)
            assert (np.asarray(frame) == value).all()
            del frame


def test_a_frame_longer_than_the_length_register_is_refused_with_the_width_that_it_takes(board: cm.Board) -> None:
    with pytest.raises(InvalidRequest, match=f"moves {LONGEST} at most.*of 15 bits or more"):
        board.configure_stream("from_pl", shape=(128, 128))


def test_the_list_of_streams_says_that_lengths_are_not_known(
    board: cm.Board, both: tuple[Manager, SimBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    board.configure_stream("from_pl", shape=(100, 100), enable=True)
    found = state(board, "from_pl")
    assert (found.exact, found.max_length) == (True, LONGEST)
    assert main(["stream", "list", "--runtime-dir", str(both[0].runtime)]) == 0
    assert "from_pl: its DMA cannot tell how much arrived" in capsys.readouterr().out


def test_a_stream_of_an_engine_with_scatter_gather_tells_lengths(board: cm.Board) -> None:
    board.configure_stream("camera", enable=True)
    assert not state(board, "camera").exact


def test_an_engine_whose_register_is_read_tells_lengths(root: Path) -> None:
    with AxiDma.open("to_pl", root) as sender:
        assert sender.info.caps == DmaCaps.SIMPLE | DmaCaps.CYCLIC | DmaCaps.RESIDUE
        assert sender.info.max_length == LONGEST


def test_a_short_packet_completes_as_long_as_was_asked_for(root: Path) -> None:
    with AxiDma.open("from_pl", root) as receiver, AxiDma.open("to_pl", root) as sender:
        assert receiver.info.caps == DmaCaps.SIMPLE | DmaCaps.CYCLIC
        assert not receiver.info.tells_length
        into, out = receiver.allocate(4096), sender.allocate(4096)
        receiver.submit(into, length=4096)
        sender.submit(out, length=100)
        assert sender.wait(timeout=60).length == 100
        assert receiver.wait(timeout=60).length == 4096


def test_a_transfer_above_the_length_register_is_refused_by_the_channel(root: Path) -> None:
    with AxiDma.open("from_pl", root) as receiver:
        buffer = receiver.allocate(LONGEST + 1)
        with pytest.raises(DeviceError, match=r"(?i)message too long"):
            receiver.submit(buffer, length=LONGEST + 1)

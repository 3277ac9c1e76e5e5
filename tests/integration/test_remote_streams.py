# SPDX-License-Identifier: Apache-2.0
"""Frames over ZeroMQ: what may wait for a slow subscriber, and the newest frame."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from manager_process import CAMERA, Manager, served, until

import cm
from cm.client.stream import NewestStream, RemoteStream
from cm.errors import InvalidRequest
from cm.schema import load
from cm.server.publisher import mark
from cm.wire import cm_pb2 as pb

LARGE = 4 << 20


@contextlib.contextmanager
def listening(env: dict[str, str] | None = None, settings: str = "") -> Iterator[tuple[Manager, str]]:
    """A manager that listens on TCP as well, and where."""
    arguments = ("--listen", "tcp://127.0.0.1:0", "--insecure")
    with served(arguments=arguments, env=env, settings=settings) as (manager, _):
        yield manager, manager.tcp()


@pytest.fixture
def far(board: cm.Board) -> cm.Board:
    """The board as seen by a client without a data socket: everything goes over ZeroMQ."""
    board._place = replace(board._place, data=None)
    return board


def socket_of(stream: Any) -> Any:
    """The ZeroMQ socket of a stream that is subscribed to."""
    stream.open()
    return stream._reader._subscription.socket


def rss(manager: Manager) -> int:
    """Resident memory of the manager, without what it shares with others; in bytes."""
    assert manager.process is not None
    text = Path(f"/proc/{manager.process.pid}/status").read_text()
    return int(next(line for line in text.splitlines() if line.startswith("RssAnon")).split()[1]) * 1024


def overruns(board: cm.Board, name: str) -> int:
    return next(s for s in board.status.streams if s.name == name).overruns


# ---- slow subscribers --------------------------------------------------------------------


def test_what_waits_for_a_stopped_subscriber_is_bounded_in_bytes(context: zmq.Context) -> None:
    queue = 8 << 20  # the schema's frames are shorter than 1 MiB: eight wait, however long they are made
    with listening(settings="streams: {queue_mib: 8}\n") as (manager, address), manager.connected() as board:
        assert mark([load(CAMERA / "camera.yaml")], queue) == 8
        board.load("camera", "default")
        board.load("camera", "loopback")
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, shape=(LARGE,), force=True)
        lively, stuck = context.socket(zmq.SUB), context.socket(zmq.SUB)
        stuck.setsockopt(zmq.RCVHWM, 1)
        data = np.zeros(LARGE, np.uint8)
        lively_got: list[int] = []
        with board.writer("to_pl", timeout=60) as writer:

            def subscribe(socket: zmq.Socket[bytes]) -> None:
                """Subscribe and wait for a frame, as the subscription takes a while."""
                socket.connect(address)
                socket.subscribe(b"cm_stream/from_pl")
                until(lambda: next(s for s in board.status.streams if s.name == "from_pl").open)
                while not socket.poll(50):
                    writer.write(data)
                    writer.flush()

            def take() -> int:
                message = lively.recv_multipart()
                lively_got.append(pb.Frame.FromString(message[1]).sequence)
                return int(message[2][0])

            subscribe(lively)
            subscribe(stuck)
            before = 0
            for number in range(1, 61):
                data[:8] = number
                writer.write(data)
                writer.flush()
                assert lively.poll(60_000), "a stopped subscriber takes frames from another"
                until(lambda number=number: take() == number)  # its first frame comes after earlier ones
                before = before or rss(manager)
        until(lambda: overruns(board, "from_pl") > 0)
        # 60 frames have 240 MiB; 32 MiB wait, and what libzmq, the kernel and malloc hold
        assert rss(manager) - before < 80 << 20
        sequences = []
        while stuck.poll(1000 if len(sequences) >= 8 else 60_000):
            sequences.append(pb.Frame.FromString(stuck.recv_multipart()[1]).sequence)
        assert 8 <= len(sequences) < 30
        published = lively_got[lively_got.index(sequences[0]) :]
        assert sequences[:8] == published[:8], "the oldest wait"
        assert sequences == sorted(sequences), "in order"  # with gaps, if the kernel took more of them meanwhile


def test_how_much_may_wait_at_the_client_is_the_streams_depth(far: cm.Board) -> None:
    far.load("camera", "loopback")
    for name in ("to_pl", "from_pl"):
        far.configure_stream(name, shape=(1 << 20,), force=True)  # earlier readers may not be gone yet
    with far.stream("from_pl", depth=40, timeout=60) as deep, far.stream("from_pl", depth=1, timeout=60) as shallow:
        until(lambda: next(s for s in far.status.streams if s.name == "from_pl").open)
        assert isinstance(deep, RemoteStream)
        assert [socket_of(s).getsockopt(zmq.RCVHWM) for s in (deep, shallow)] == [40, 1]
    with pytest.raises(InvalidRequest, match="depth -1"):
        far.stream("from_pl", depth=-1, timeout=60)


def test_a_client_behind_with_frames_costs_others_no_interrupt_or_status(context: zmq.Context) -> None:
    with listening() as (manager, address), manager.connected() as board:
        board.load("camera", "default")
        board.load("camera", "loopback")
        for name in ("to_pl", "from_pl"):
            board.configure_stream(name, shape=(LARGE,), force=True)
        stuck, listener = context.socket(zmq.SUB), context.socket(zmq.SUB)
        stuck.setsockopt(zmq.RCVHWM, 1)
        stuck.connect(address)
        stuck.subscribe(b"cm_stream/from_pl")
        listener.connect(address)
        listener.subscribe(b"cm_read_reg")
        until(lambda: next(s for s in board.status.streams if s.name == "from_pl").open)
        board.registers["focus"] = 0
        assert listener.poll(60_000)
        listener.recv_multipart()
        with board.writer("to_pl", timeout=60) as writer:
            for _ in range(30):
                writer.write(np.zeros(LARGE, np.uint8))
            writer.flush()
        for value in range(200):
            board.registers["focus"] = value % 16
        got = [pb.RegValues.FromString(listener.recv_multipart()[1]).values[0].value for _ in range(200)]
        assert len(got) == 200


def test_subscribers_may_come_and_go(board: cm.Board, manager: Manager, context: zmq.Context) -> None:
    """Setting a high-water mark meanwhile made libzmq use freed memory after some eight such rounds."""
    for _ in range(40):
        sockets = [context.socket(zmq.SUB) for _ in range(4)]
        for socket in sockets:
            socket.connect(f"ipc://{manager.runtime}/pub")
            socket.subscribe(b"cm_stream/camera")
            socket.subscribe(b"cm_status")
        assert sockets[0].poll(60_000)
        for socket in sockets:
            socket.close(linger=0)
    assert board.status.config_name == "camera"


# ---- the newest --------------------------------------------------------------------------


def test_the_newest_is_asked_for_when_it_is_read(far: cm.Board) -> None:
    with far.stream("camera", newest=True, timeout=60) as stream, far.stream("camera", timeout=60) as all_frames:
        assert isinstance(stream, NewestStream)
        assert isinstance(all_frames, RemoteStream)
        first = stream.read()
        assert first.shape == (480, 640)
        last = next(frame.sequence for frame in all_frames if frame.sequence > first.sequence + 8)
        assert stream.read().sequence > last - 2
        assert stream.lost > 5


def test_the_newest_goes_on_after_a_change_of_mode(far: cm.Board) -> None:
    with far.stream("camera", newest=True, timeout=60) as stream:
        stream.read()
        far.mode = "colorise"
        assert stream.read().shape == (480, 640, 3)
        far.mode = "default"
        assert stream.read().info.mode == "default"

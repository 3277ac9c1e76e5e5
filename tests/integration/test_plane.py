# SPDX-License-Identifier: Apache-2.0
"""Frames without copies: what readers and writers on the manager's machine can rely on."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from manager_process import Manager, environment, until
from plane_stress import warm

import cm
from cm.errors import InvalidRequest, Timeout
from cm.simulation.software import Board as SimBoard
from cm.wire import plane_packets as packets
from cm.wire.messages.status import ClientStatus
from cm.wire.plane_packets import Descriptor, Open, Purpose

HOLDER = """
import sys, time, cm
with cm.connect(runtime_dir=sys.argv[1], timeout=60) as board, board.stream("camera", timeout=60) as stream:
    held = [stream.read() for _ in range(4)]
    print("holding", flush=True)
    time.sleep(600)
"""


def state(board: cm.Board, name: str) -> cm.wire.messages.status.StreamStatus:
    return next(s for s in board.status.streams if s.name == name)


def fds(manager: Manager) -> int:
    assert manager.process is not None
    return len(list(Path(f"/proc/{manager.process.pid}/fd").iterdir()))


packet_like = st.builds(
    lambda head, rest: Descriptor(*head).pack() + rest,
    st.tuples(
        st.integers(0, 65535),
        st.integers(0, 30),
        st.integers(0, 255),
        st.integers(0, 2**32 - 1),
        *[st.one_of(st.integers(0, 2**64 - 1), st.integers(0, 5000))] * 3,
    ),
    st.one_of(
        st.just(b""), st.binary(max_size=60), st.sampled_from([b"camera", b"to_pl", b"camera\0\0\0", b"\xff\xfe"])
    ),
)


@pytest.fixture
def loop(board: cm.Board) -> Iterator[cm.Board]:
    """The board with a loop from `to_pl` to `from_pl`."""
    board.load("camera", "loopback")
    yield board
    for name in ("to_pl", "from_pl"):
        board.configure_stream(name, shape=(480, 640), dtype="uint8", force=True)


class Raw:
    """A client that may break all rules of the protocol."""

    def __init__(self, manager: Manager, wanted: Open | bytes) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.settimeout(60)
        self.socket.connect(str(manager.runtime / "data"))
        self.socket.send(packets.encode_open(wanted) if isinstance(wanted, Open) else wanted)

    def next(self, kind: int) -> Descriptor:
        while True:
            data = self.socket.recv(packets.PACKET_MAX)
            assert data, "hung up"
            head = Descriptor(*packets.DESCRIPTOR.unpack_from(data))
            if head.kind == kind:
                return head

    def close(self) -> None:
        self.socket.close()

    def hung_up(self) -> bool:
        try:
            while self.socket.recv(packets.PACKET_MAX):
                pass
        except ConnectionError:
            pass
        return True


@pytest.fixture
def raw(manager: Manager) -> Iterator[Callable[[Open | bytes], Raw]]:
    """A factory of connections that are closed at the end of the test."""
    with contextlib.ExitStack() as stack:
        yield lambda wanted: stack.enter_context(contextlib.closing(Raw(manager, wanted)))


# ---- reading ---------------------------------------------------------------------------


def test_a_frame_is_the_slot_itself(loop: cm.Board) -> None:
    with loop.stream("from_pl", timeout=60) as reader, loop.writer("to_pl", timeout=60) as writer:
        with writer.slot() as array:
            array[...] = 17
        frame = reader.read()
        maps = Path("/proc/self/maps").read_text()
        address = frame.__array_interface__["data"][0]
        line = next(m for m in maps.splitlines() if _covers(m, address))
        assert "cm-sim-buffer" in line
        assert line.split()[1] == "r--s"
        assert (np.asarray(frame) == 17).all()


def _covers(line: str, address: int) -> bool:
    first, last = (int(x, 16) for x in line.split()[0].split("-"))
    return first <= address < last


def test_a_frame_that_is_held_does_not_change(board: cm.Board) -> None:
    with board.stream("camera", depth=2, timeout=60) as stream, board.stream("camera", depth=20, timeout=60) as other:
        held = stream.read()
        content = held.copy()
        frames = [frame.sequence for frame in islice(other, 20)]
        assert frames[-1] - frames[0] == 19, "one who holds frames makes others lose them"
        assert (held == content).all()


def test_views_keep_the_lease(board: cm.Board) -> None:
    with board.stream("camera", depth=1, timeout=60) as stream:
        row = stream.read()[17]
        content = row.copy()
        with pytest.raises(Timeout):
            stream.read(timeout=0.2)
        assert (row == content).all()
        del row
        stream.read()


def test_other_libraries_take_frames_as_they_are(board: cm.Board) -> None:
    from PIL import Image

    with board.stream("camera", timeout=60) as stream:
        frame = stream.read()
        content = frame.copy()
        assert memoryview(frame).tobytes() == content.tobytes()
        assert np.asarray(Image.fromarray(frame)).tobytes() == content.tobytes()
        assert Image.frombuffer("L", (640, 480), frame, "raw", "L", 0, 1).tobytes() == content.tobytes()
        if np.lib.NumpyVersion(np.__version__) >= "2.1.0":
            taken = np.from_dlpack(frame)
            assert taken.__array_interface__["data"][0] == frame.__array_interface__["data"][0]


def test_a_stream_goes_on_in_its_new_shape_after_a_change_of_mode(board: cm.Board) -> None:
    with board.stream("camera", timeout=60) as stream:
        old = stream.read()
        content = old.copy()
        board.mode = "colorise"
        new = next(f for f in stream if f.info.mode == "colorise")
        assert new.shape == (480, 640, 3)
        assert (old == content).all(), "memory of a stopped stream is used again"
        old.release()
        del new
        board.mode = "default"
        assert next(f for f in stream if f.info.mode == "default").shape == (480, 640)


def test_frames_that_are_held_beyond_their_stream_are_not_written_over(board: cm.Board) -> None:
    def ours() -> ClientStatus:
        return next(c for c in state(board, "camera").clients if c.depth == 3)

    with board.stream("camera", timeout=60) as other:
        with board.stream("camera", depth=3, timeout=60) as stream:
            held = [stream.read(), stream.read()]
            until(lambda: ours().held == 3)  # one more is waiting, unread
        until(lambda: ours().held == 2)
        left = ours()
        contents = [frame.copy() for frame in held]
        for number, _ in enumerate(islice(other, 40)):
            if number == 20:
                later = ours()
                assert (later.held, later.dropped) == (2, left.dropped), "who has closed loses nothing"
        assert all((a == b).all() for a, b in zip(held, contents, strict=True)), "written over"
        held.pop()
        until(lambda: ours().held == 1)
        held.clear()
        until(lambda: len(state(board, "camera").clients) == 1)


def test_a_frame_that_is_held_keeps_no_stream_open(board: cm.Board) -> None:
    with board.stream("camera", timeout=60) as stream:
        held = stream.read()
    content = held.copy()
    until(lambda: not state(board, "camera").open)
    with board.stream("camera", timeout=60) as stream:
        assert stream.read().sequence >= 0
        assert (held == content).all()
    held.release()


# ---- refusals ----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.one_of(st.binary(max_size=200), packet_like), min_size=1, max_size=4), st.booleans())
def test_no_sequence_of_packets_brings_the_plane_down(
    board: cm.Board, manager: Manager, sent: list[bytes], opened: bool
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as peer:
        peer.connect(str(manager.runtime / "data"))
        with contextlib.suppress(OSError):
            for packet in [packets.encode_open(Open("camera"))] * opened + sent:
                peer.send(packet)
    assert board.status.mode == "default"
    with board.echo(64, timeout=60) as echo:
        echo.round_trip()


def test_a_client_that_breaks_the_rules_later_is_disconnected(board: cm.Board, raw: Callable[..., Raw]) -> None:
    with board.stream("camera", timeout=60) as other:
        for packet in (b"x", b"\0" * 31, b"\0" * 33, b"\0" * 32, b"\xff" * 32):
            peer = raw(Open("camera"))
            peer.next(packets.FRAME)
            peer.socket.send(packet)
            assert peer.hung_up(), packet
        assert [f.sequence for f in islice(other, 3)]


def test_a_slot_that_is_not_held_cannot_be_given_back(board: cm.Board, raw: Callable[..., Raw]) -> None:
    peer = raw(Open("camera", depth=1))
    frame = peer.next(packets.FRAME)
    peer.socket.send(frame._replace(kind=packets.RELEASE).pack())
    peer.socket.send(frame._replace(kind=packets.RELEASE).pack())
    assert peer.next(packets.LATE).sequence == frame.sequence
    peer.socket.send(frame._replace(kind=packets.RELEASE, slot=65535).pack())
    assert peer.next(packets.LATE).slot == 65535


def test_a_writer_cannot_send_a_slot_that_it_does_not_hold(loop: cm.Board, raw: Callable[..., Raw]) -> None:
    peer = raw(Open("to_pl", Purpose.WRITE, depth=1))
    grant = peer.next(packets.GRANT)
    for wrong in (
        {"slot": grant.slot + 1},
        {"slot": 65535},
        {"length": 0},
        {"length": 1 << 63},
        {"offset": 480 * 640, "length": 1},
    ):
        peer.socket.send(grant._replace(kind=packets.SUBMIT, **{"length": 100, **wrong}).pack())
        assert peer.next(packets.DONE).offset == 22, wrong


# ---- leases --------------------------------------------------------------------------------


def test_the_status_says_which_client_lost_how_much(board: cm.Board) -> None:
    with board.stream("camera", depth=1, timeout=60) as slow, board.stream("camera", depth=3, timeout=60) as quick:
        held = slow.read()
        last = [frame.sequence for frame in islice(quick, 20)][-1]
        clients = {c.depth: c for c in state(board, "camera").clients}
        assert clients[1].pid == clients[3].pid == os.getpid()
        assert clients[1].name == Path("/proc/self/comm").read_text().strip()
        assert (clients[1].held, clients[1].writes) == (1, False)
        assert clients[1].dropped >= 18
        assert clients[3].dropped < clients[1].dropped
        assert clients[3].frames >= 20
        del held
        after = until(lambda: slow.read().sequence)
        assert after > last - 2
        assert slow.lost <= next(c for c in state(board, "camera").clients if c.depth == 1).dropped


# ---- writing -----------------------------------------------------------------------------


def test_a_failed_block_sends_nothing(loop: cm.Board) -> None:
    with loop.stream("from_pl", timeout=60) as reader, loop.writer("to_pl", depth=1, timeout=60) as writer:
        with pytest.raises(ZeroDivisionError), writer.slot():
            _ = 1 / 0
        with pytest.raises(Timeout):
            reader.read(timeout=0.2)
        writer.write(np.full((480, 640), 3, np.uint8))
        assert reader.read()[0, 0] == 3


@pytest.mark.parametrize("copy", [False, True], ids=["local", "over ZeroMQ"])
def test_transfers_that_fail_leave_a_gap_and_the_frame_behind_it_says_how_many_and_why(
    board: cm.Board, shared: tuple[Manager, SimBoard], copy: bool
) -> None:
    with board.stream("camera", depth=32, copy=copy, timeout=60) as stream:
        last = stream.read().sequence
        shared[1].control.inject("dma_error", "camera", count=3)
        for frame in stream:
            if frame.info.failed:
                break
            last = frame.sequence
        assert frame.info.failed == 3
        assert frame.info.lost == frame.sequence - last - 1 >= 3
        assert stream.lost >= 3
        assert stream.read().info.failed == 0, "what was told is not told again"


def test_a_packet_that_is_longer_than_its_slot_leaves_a_gap(loop: cm.Board) -> None:
    loop.configure_stream("from_pl", shape=(64,), force=True)
    loop.configure_stream("to_pl", shape=(128,), force=True)
    with loop.stream("from_pl", timeout=60) as reader, loop.writer("to_pl", timeout=60) as writer:
        with writer.slot(64) as slot:
            slot[...] = 1
        assert reader.read().shape == (64,)
        writer.write(np.zeros(128, np.uint8))
        with writer.slot(64) as slot:
            slot[...] = 2
        info = reader.read().info
        assert (info.lost, info.failed) == (1, 1)


@pytest.mark.parametrize("length", [-1, 480 * 640 + 1, 1 << 40])
def test_a_wrong_length_costs_a_writer_no_slot(loop: cm.Board, length: int) -> None:
    with loop.writer("to_pl", depth=2, timeout=60) as writer:
        for _ in range(5):
            with pytest.raises(InvalidRequest, match="takes 1 to 307200 bytes"), writer.slot(length):
                pass
        until(lambda: writer.catch_up() or writer.free == 2)  # type: ignore[func-returns-value]


def test_a_reader_whose_stream_another_thread_closes_is_told_that(board: cm.Board) -> None:
    board.load("camera", "loopback")
    stream = board.stream("from_pl", timeout=60)
    stream.open()
    closing = threading.Timer(0.1, stream.close)
    closing.start()
    with pytest.raises(InvalidRequest, match="'from_pl' was closed"):
        stream.read()
    closing.join()


def test_nothing_is_seen_of_a_frame_that_was_given_back(board: cm.Board) -> None:
    with board.stream("camera", timeout=60) as stream:
        frame = stream.read()
        info, row = frame.info, frame[0]
        frame.release()
        assert np.asarray(frame).size == 0 == memoryview(frame).nbytes
        assert frame.info == info
        assert row.shape == (640,), "arrays made before stay mapped"
        row.sum()


# ---- settings ------------------------------------------------------------------------------


def test_a_limit_thins_the_stream_out(board: cm.Board) -> None:
    board.configure_stream("camera", rate=10, force=True)
    with board.stream("camera", depth=8, timeout=60) as stream:
        times = [f.timestamp_ns for f in islice(stream, 6)]
        sequences = [f.sequence for f in islice(stream, 2)]
    assert 5e9 / (times[-1] - times[0]) < 12, "five gaps in a second at most; a busy machine makes them longer"
    assert sequences[1] - sequences[0] == 1, "what a limit leaves out is not a loss"
    board.configure_stream("camera", rate=float("inf"), force=True)


# ---- clients that die -----------------------------------------------------------------------


def test_a_killed_reader_gives_everything_back(board: cm.Board, shared: tuple[Manager, SimBoard]) -> None:
    manager, sim = shared
    warm(board)
    before = fds(manager)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(manager.runtime)], stdout=subprocess.PIPE, env=environment()
    )
    assert holder.stdout is not None
    assert holder.stdout.readline()
    assert state(board, "camera").open
    holder.send_signal(signal.SIGKILL)
    holder.communicate()
    until(lambda: not state(board, "camera").open)
    until(lambda: fds(manager) <= before)
    until(lambda: not sim.control.state()["channels"]["camera"]["open"])  # once it sees that its node was closed

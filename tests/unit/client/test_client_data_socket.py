# SPDX-License-Identifier: Apache-2.0
"""Frames, slots and memory over the data socket, for both boards: a manager that the test plays, packet by packet."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import inspect
import itertools
import os
import re
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import short_folder

from cm.client import aio, data_connection
from cm.client.board import Board
from cm.client.errors import ConnectionLost, FrameReleased, LateRelease, RequestBusy, TransferFailed
from cm.errors import InvalidRequest, Timeout
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor, Geometry, Open, Purpose

HUNG = 60.0
PAGE = os.sysconf("SC_PAGE_SIZE")
EPOCH = 3
FORM = Geometry(PAGE, 6, depth=2, shape=(2, 3), stream="camera", config_name="camera", mode="edge")
GRANT = Descriptor(1, packets.GRANT, EPOCH)
BOTH = pytest.mark.parametrize("client", [Board, aio.Board], ids=["blocking", "asyncio"])


async def now(value: Any) -> Any:
    """What both boards give: the one at once, the other when it is awaited."""
    return await value if inspect.isawaitable(value) else value


def geometry(form: Geometry = FORM) -> bytes:
    packet = packets.encode_geometry(form)
    return Descriptor(*packets.DESCRIPTOR.unpack_from(packet))._replace(flags=EPOCH).pack() + packet[32:]


def frame(slot: int, sequence: int, length: int = 6) -> Descriptor:
    return Descriptor(slot, packets.FRAME, 0, 0, length, sequence, 1000 + sequence)


class Manager:
    """The data socket of a manager, and two slots of a page each."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "req").touch()
        self.slots = [os.memfd_create("slot") for _ in range(2)]
        for number, slot in enumerate(self.slots):
            os.ftruncate(slot, PAGE)
            os.pwrite(slot, bytes(range(10 * number, 10 * number + 6)), 0)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.settimeout(HUNG)
        self._listener.bind(str(folder / packets.SOCKET))
        self._listener.listen()
        self._peer: socket.socket | None = None
        self._asked = b""
        self._thread = threading.Thread(target=lambda: None)

    def answers(self, *sent: bytes | Descriptor) -> None:
        """Send this to the next client once it has asked for something; the slots go with a SLOTS packet."""

        def serve() -> None:
            if self._peer is not None:
                self._peer.close()
            self._peer, _ = self._listener.accept()
            self._peer.settimeout(HUNG)
            self._asked = self._peer.recv(packets.PACKET_MAX)
            self.sends(*sent)

        self._thread = threading.Thread(target=serve, daemon=True)
        self._thread.start()

    @property
    def peer(self) -> socket.socket:
        self._thread.join(HUNG)
        assert self._peer is not None
        return self._peer

    @property
    def asked(self) -> Open:
        """What it asked for."""
        assert self.peer
        return packets.decode_open(self._asked)

    def sends(self, *sent: bytes | Descriptor) -> None:
        assert self._peer is not None
        for one in sent:
            with_slots = isinstance(one, Descriptor) and one.kind == packets.SLOTS
            packet = one.pack() if isinstance(one, Descriptor) else one
            socket.send_fds(self._peer, [packet], self.slots if with_slots else [])

    def got(self) -> Descriptor:
        """The next packet of the client."""
        return Descriptor(*packets.DESCRIPTOR.unpack_from(self.peer.recv(packets.PACKET_MAX)))

    def hang_up(self) -> None:
        self.peer.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()
        if self._peer is not None:
            self._peer.close()
        for slot in self.slots:
            os.close(slot)


@pytest.fixture
def manager() -> Iterator[Manager]:
    with short_folder() as folder:
        made = Manager(folder)
        yield made
        made.close()


SLOTS = Descriptor(kind=packets.SLOTS, offset=2)
STOPPED = Descriptor(kind=packets.STOPPED)


def used(client: Callable[..., Any], manager: Manager, course: Callable[[Any], Any]) -> Any:
    """Go through a course with a board, which is closed at its end."""

    async def whole() -> Any:
        board = client(runtime_dir=manager.folder)
        try:
            return await course(board)
        finally:
            await now(board.close())

    watch = threading.Timer(HUNG, manager.hang_up)  # whoever waits for ever
    watch.start()
    try:
        return asyncio.run(whole())
    finally:
        watch.cancel()


@BOTH
def test_frames_come_with_what_is_known_of_them_and_go_back(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(), SLOTS, frame(1, 4))

    async def course(board: Any) -> None:
        stream = board.stream("camera", HUNG, depth=2, lease="l")
        assert stream.geometry is None
        first = await now(stream.read(HUNG))
        assert manager.asked == Open("camera", depth=2, lease="l")
        assert stream.geometry == FORM
        assert (first.tolist(), first.flags.writeable) == ([[10, 11, 12], [13, 14, 15]], False)
        info = first.info
        assert (info.stream, info.config_name, info.mode) == ("camera", "camera", "edge")
        assert (info.sequence, info.timestamp_ns, info.length, info.shape) == (4, 1004, 6, (2, 3))
        assert info.generation == first.generation == 0
        manager.sends(
            Descriptor(kind=packets.GENERATION, sequence=9), packets.encode_label("camera", "other", "on"), frame(0, 7)
        )
        second = await now(stream.read(HUNG))
        assert (second.tolist(), second.sequence, second.generation, stream.lost) == ([[0, 1, 2], [3, 4, 5]], 7, 9, 2)
        assert (second.info.config_name, second.info.mode) == ("other", "on")
        assert (first.info.config_name, first.info.mode) == ("camera", "edge")
        first.release()
        assert manager.got() == frame(1, 4)._replace(kind=packets.RELEASE)
        manager.sends(STOPPED, geometry(), SLOTS, frame(0, 1, length=4))
        short = await now(stream.read(HUNG))
        assert (short.tolist(), stream.lost, short.generation) == ([0, 1, 2, 3], 2, 0)  # numbers begin anew
        second.release()  # its memory is not used again
        short.release()
        assert manager.got() == frame(0, 1, length=4)._replace(kind=packets.RELEASE)
        await now(stream.close())

    used(client, manager, course)


@BOTH
@pytest.mark.parametrize("known", [True, False], ids=["64 bits", "32 bits"])
@pytest.mark.parametrize(
    ("sent", "says"),
    [
        ((geometry(), SLOTS), r"0\.125 s$"),
        ((STOPPED,), r"0\.125 s: it is stopped"),
        ((geometry(), SLOTS, frame(0, 1), frame(1, 2)), r"0\.125 s: all 2 frames that may be held are"),
    ],
    ids=["nothing", "stopped", "all are held"],
)
def test_a_frame_that_does_not_come_is_a_time_out_with_the_reason(
    client: Any, manager: Manager, sent: tuple[Any, ...], says: str, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(data_connection, "LIMITS_ARE_KNOWN", known)
    manager.answers(*sent)

    async def course(board: Any) -> None:
        stream = board.stream("camera", 0.125, depth=2)
        held = [
            await now(stream.read(HUNG)) for one in sent if isinstance(one, Descriptor) and one.kind == packets.FRAME
        ]
        with pytest.raises(Timeout, match=rf"^stream 'camera' gave no frame within {says}"):
            await now(stream.read())
        with pytest.raises(Timeout, match=r"no frame within 0 s"):
            await now(stream.read(0))
        del held

    used(client, manager, course)


@BOTH
def test_only_the_newest_of_the_frames_that_wait_is_read_if_that_is_wanted(
    client: Callable[..., Any], manager: Manager
) -> None:
    manager.answers(geometry(), SLOTS, frame(0, 1), frame(1, 2))

    async def course(board: Any) -> None:
        stream = board.stream("camera", HUNG, newest=True)
        await now(stream.open())
        assert manager.peer  # all was sent
        assert (await now(stream.read(HUNG))).sequence == 2
        assert manager.got() == frame(0, 1)._replace(kind=packets.RELEASE)

    used(client, manager, course)


OPENED: list[tuple[Callable[[Any], Any], Open]] = [
    (lambda b: b.stream("camera", HUNG, depth=3, lease="l").open(), Open("camera", depth=3, lease="l")),
    (lambda b: b.stream("camera", HUNG, lease="l", raw=True).read(), Open("camera", lease="l")),
    (lambda b: _writer(b.writer("to_pl", HUNG, depth=3, lease="l")), Open("to_pl", Purpose.WRITE, depth=3, lease="l")),
    (lambda b: _writer(b.echo(64, HUNG, depth=3)), Open("", Purpose.ECHO, depth=3, length=64)),
    (lambda b: _writer(b.echo(64, HUNG)), Open("", Purpose.ECHO, depth=2, length=64)),
    (lambda b: b.allocate((4, 8), "uint16", HUNG), Open("", Purpose.ALLOCATE, length=64)),
    (lambda b: b.allocate(4), Open("", Purpose.ALLOCATE, length=4)),
    (lambda b: b.registers.window("edge", timeout=HUNG), Open("edge", Purpose.WRITABLE_WINDOW)),
    (
        lambda b: b.registers.window("edge", write=False, wait=True, exclusive=True, lease="l"),
        Open("edge", Purpose.WINDOW, wait=True, exclusive=True, lease="l"),
    ),
]


def _writer(made: Any) -> Any:
    """A writer that is open; one for asyncio has to be awaited."""
    return made.__aenter__() if hasattr(made, "__aenter__") else made


@BOTH
@pytest.mark.parametrize(("use", "wanted"), OPENED)
def test_what_is_asked_for_and_refused(
    client: Callable[..., Any], manager: Manager, use: Callable[[Any], Any], wanted: Open
) -> None:
    manager.answers(packets.encode_refused("busy", "not now"))

    async def course(board: Any) -> None:
        with pytest.raises(RequestBusy, match="not now"):
            await now(use(board))

    used(client, manager, course)
    assert manager.asked == wanted


@BOTH
def test_a_manager_that_hangs_up_is_lost(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(), SLOTS)

    async def course(board: Any) -> None:
        stream = board.stream("camera", HUNG)
        await now(stream.open())
        manager.hang_up()
        with pytest.raises(ConnectionLost, match=r"^the configuration manager hung up on the data socket$"):
            await now(stream.read(HUNG))

    used(client, manager, course)


@BOTH
def test_a_stream_that_is_closed_gives_back_what_it_has_not_read_and_then_what_is_held(
    client: Callable[..., Any], manager: Manager
) -> None:
    manager.answers(geometry(), SLOTS, frame(1, 4))

    async def course(board: Any) -> None:
        stream = board.stream("camera", HUNG)
        held = await now(stream.read())
        manager.sends(frame(0, 5), Descriptor(kind=packets.GENERATION, sequence=9))
        await now(stream.close())
        await now(stream.close())
        assert (stream.geometry, stream.lost) == (None, 0)
        with pytest.raises(InvalidRequest, match="'camera' was closed: ask for another"):
            await now(stream.read())
        assert [manager.got() for _ in range(2)] == [
            frame(0, 5)._replace(kind=packets.RELEASE),
            Descriptor(kind=packets.LEAVE),
        ]
        assert (held.tolist(), held.sequence) == ([[10, 11, 12], [13, 14, 15]], 4)
        del held
        assert manager.got() == frame(1, 4)._replace(kind=packets.RELEASE)
        assert await asyncio.to_thread(manager.peer.recv, 1) == b""

    used(client, manager, course)


@BOTH
def test_what_is_missing_before_a_frame_is_told_with_it_and_why(client: Callable[..., Any], manager: Manager) -> None:
    failed = [Descriptor(kind=packets.FAILED, sequence=count) for count in (2, 5)]
    manager.answers(geometry(), SLOTS, failed[0], frame(1, 7), frame(0, 9), failed[1], frame(1, 14), frame(0, 15))

    async def course(board: Any) -> None:
        stream = board.stream("camera", HUNG)
        told = [(await now(stream.read())).info for _ in range(4)]
        assert [(info.sequence, info.lost, info.failed) for info in told] == [
            (7, 0, 0),  # what failed before it is no gap of ours
            (9, 1, 0),
            (14, 4, 3),
            (15, 0, 0),
        ]
        await now(stream.close())
        assert stream.lost == 5

    used(client, manager, course)


@BOTH
def test_a_frame_that_was_taken_away_is_named(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(), SLOTS, Descriptor(1, packets.LATE, sequence=4))

    async def course(board: Any) -> None:
        with pytest.raises(
            LateRelease, match=r"was given back, but slot 1 is not ours: its content was not ours either$"
        ):
            await now(board.stream("camera", HUNG).read(HUNG))

    used(client, manager, course)


def done(sequence: int, error: int = 0) -> Descriptor:
    return Descriptor(1, packets.DONE, EPOCH, error, sequence=sequence)


@BOTH
def test_a_slot_is_granted_filled_sent_and_free_again(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(Geometry(PAGE, 6, writable=True, shape=(2, 3), stream="to_pl")), SLOTS, GRANT)

    async def course(board: Any) -> None:
        writer = await now(_writer(board.writer("to_pl", HUNG)))
        assert (writer.free, writer.under_way, repr(writer)) == (1, 0, "<writer of to_pl>")
        await now(writer.write(b"abcdef"))
        assert os.pread(manager.slots[1], 6, 0) == b"abcdef"
        assert manager.got() == Descriptor(1, packets.SUBMIT, EPOCH, 0, 6, 0)
        assert (writer.free, writer.under_way) == (0, 1)
        for wait in (lambda: writer.flush(0.125), lambda: writer.write(b"ghijkl", 0.125)):
            with pytest.raises(Timeout, match=r"'to_pl': the hardware took nothing within 0\.125 s; is anything"):
                await now(wait())
        manager.sends(done(0))
        await now(writer.flush(HUNG))
        assert (writer.free, writer.under_way) == (1, 0)
        with pytest.raises(InvalidRequest, match=r"takes frames of 6 bytes, .* uint8; this one has 5, \(5,\) uint8"):
            await now(writer.write(b"ghijk"))
        await now(writer.write(b"ghijkl"))
        assert manager.got().sequence == 1
        manager.sends(done(1, errno.EIO))
        with pytest.raises(TransferFailed, match=r"'to_pl': frame 1 was not taken: Input/output error"):
            await now(writer.flush(HUNG))
        await now(writer.close())
        await now(writer.close())
        for use in (writer.flush, lambda: writer.write(b"abcdef"), writer.round_trip):
            with pytest.raises(InvalidRequest, match=r"^the writer of 'to_pl' was closed: ask for another$"):
                await now(use())

    used(client, manager, course)


OURS = Geometry(PAGE, 6, writable=True, shape=(2, 3), stream="to_pl")
WORDS = replace(OURS, frame_length=12, dtype="uint16")
PICTURE = replace(OURS, shape=(1, 2, 3), format="bgr")


@BOTH
@pytest.mark.parametrize(
    ("form", "data", "sent"),
    [
        (OURS, b"abcdef", b"abcdef"),
        (OURS, np.frombuffer(b"abcdef", np.uint8), b"abcdef"),
        (OURS, np.frombuffer(b"abcdef", np.int16), "takes frames of (2, 3) uint8; this one is (3,) int16"),
        (OURS, [1, 2], "takes frames of 6 bytes, (2, 3) uint8; this one has 16, (2,) int64"),
        (WORDS, np.arange(6, dtype=np.uint16), bytes([0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0])),
        (WORDS, bytearray(b"abcdefghijkl"), b"abcdefghijkl"),
        (WORDS, np.arange(6, dtype=np.int16).reshape(3, 2), bytes([0, 0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0])),
        (PICTURE, np.arange(6, dtype=np.uint8).reshape(1, 2, 3), bytes([2, 1, 0, 5, 4, 3])),
        (PICTURE, np.arange(6, dtype=np.uint8), bytes(range(6))),
        (replace(OURS, stride=8), b"abcdef", b"abc\2\3\4\5\0def"),
        (replace(OURS, frame_length=0, shape=None), np.array([1], np.int32), bytes([1, 0, 0, 0])),
        (replace(OURS, frame_length=0, shape=None), b"ab", b"ab"),
    ],
)
def test_what_is_written_lies_in_the_slot_as_the_stream_has_it(
    client: Callable[..., Any], manager: Manager, form: Geometry, data: Any, sent: bytes | str
) -> None:
    os.pwrite(manager.slots[1], b"\xff\0\1\2\3\4\5\0", 0)
    manager.answers(geometry(form), SLOTS, GRANT)

    async def course(board: Any) -> None:
        writer = await now(_writer(board.writer("to_pl", HUNG)))
        if isinstance(sent, str):
            with pytest.raises(InvalidRequest, match="^" + re.escape(f"stream 'to_pl' {sent}") + "$"):
                await now(writer.write(data))
            assert (writer.free, writer.under_way) == (1, 0), "it is not lost"
            return
        await now(writer.write(data))
        assert os.pread(manager.slots[1], len(sent), 0) == sent
        assert manager.got() == Descriptor(1, packets.SUBMIT, EPOCH, 0, form.frame_length or len(sent), 0)

    used(client, manager, course)


@BOTH
def test_a_slot_is_free_again_unless_the_hardware_repeats_it_or_its_memory_is_of_before(
    client: Callable[..., Any], manager: Manager
) -> None:
    later = Descriptor(1, packets.DONE, EPOCH + 1, sequence=1)
    for form, answer, free in ((OURS, done(0), 1), (replace(OURS, cyclic=True), done(0), 0), (OURS, later, 0)):
        manager.answers(geometry(form), SLOTS, GRANT)

        async def course(board: Any, answer: Descriptor = answer, free: int = free) -> None:
            writer = await now(_writer(board.writer("to_pl", HUNG)))
            await now(writer.write(b"abcdef"))
            manager.sends(answer._replace(sequence=0))
            await now(writer.flush())
            assert (writer.free, writer.under_way) == (free, 0)

        used(client, manager, course)


@BOTH
def test_a_round_trip_sends_a_whole_frame_and_waits_for_it(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(OURS), SLOTS, GRANT)

    async def course(board: Any) -> None:
        writer = await now(_writer(board.writer("to_pl", HUNG)))
        blocks = client is Board
        for number, length in enumerate((0, 4)):
            given = (length,) if length else ()
            made = asyncio.to_thread(writer.round_trip, *given) if blocks else writer.round_trip(*given)
            ended = asyncio.ensure_future(made)
            assert await asyncio.to_thread(manager.got) == Descriptor(1, packets.SUBMIT, EPOCH, 0, length or 6, number)
            assert not ended.done()
            manager.sends(done(number))
            assert (await ended).slot == 1

    used(client, manager, course)


@BOTH
def test_a_writer_that_gets_no_slot_says_so(client: Callable[..., Any], manager: Manager) -> None:
    manager.answers(geometry(), SLOTS)
    hint = r"; is anything reading the output, and is the region coupled\?$"

    async def course(board: Any) -> None:
        with pytest.raises(Timeout, match=r"^stream 'to_pl': the hardware took nothing within 0\.125 s" + hint):
            await now(_writer(board.writer("to_pl", 0.125)))

    used(client, manager, course)


@BOTH
def test_memory_comes_with_its_address_and_goes_with_its_last_array(
    client: Callable[..., Any], manager: Manager
) -> None:
    form = Geometry(PAGE, writable=True)
    manager.answers(geometry(form), SLOTS, Descriptor(kind=packets.ADDRESS, sequence=0x1000_0000))

    async def course(board: Any) -> None:
        array = await now(board.allocate((2, 3), "uint16", timeout=HUNG))
        assert (array.shape, array.dtype, array.device_address) == ((2, 3), "uint16", 0x1000_0000)
        array[...] = 0x4142
        assert os.pread(manager.slots[0], 12, 0) == b"BA" * 6
        assert array[1:].device_address == 0x1000_0006
        del array
        assert await asyncio.to_thread(manager.peer.recv, 1) == b""  # the loop holds it until it has its turn

    used(client, manager, course)


BEGIN, END, READ, WRITE = 0, 4, 1, 2  # of linux/dma-buf.h


@pytest.fixture
def synchronised(manager: Manager, monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """What is done to slots, as if their memory needed it: their numbers, and flags. Each first try is interrupted."""
    done: list[tuple[int, int]] = []
    tries = itertools.cycle((errno.EINTR, errno.EAGAIN, 0))
    numbers = {os.fstat(slot).st_ino: number for number, slot in enumerate(manager.slots)}

    def ioctl(fd: int, request: int, argument: bytes) -> None:
        error = next(tries)
        if error:
            raise OSError(error, "again")
        assert request == 0x40086200
        done.append((numbers[os.fstat(fd).st_ino], *struct.unpack("=Q", argument)))

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    return done


@BOTH
def test_memory_that_is_not_coherent_is_synchronised_once_at_each_end(
    client: Callable[..., Any], manager: Manager, synchronised: list[tuple[int, int]]
) -> None:
    async def reads(board: Any) -> None:
        stream = board.stream("camera", HUNG)
        first, second = [await now(stream.read()) for _ in range(2)]
        assert synchronised == [(1, BEGIN | READ), (0, BEGIN | READ)]
        first.release()
        first.release()
        assert synchronised[2:] == [(1, END | READ)]
        await now(stream.close())
        del second
        assert synchronised[3:] == [(0, END | READ)]

    async def writes(board: Any) -> None:
        writer = await now(_writer(board.writer("to_pl", HUNG)))
        await now(writer.write(b"abcdef"))
        assert synchronised == [(1, BEGIN | READ | WRITE), (1, END | READ | WRITE)]
        await now(writer.close())

    async def holds(board: Any) -> None:
        array = await now(board.allocate(6, timeout=HUNG))
        expected = [(0, BEGIN | READ | WRITE)]
        assert synchronised == expected
        array.sync_from_device()
        assert synchronised == expected, "it is the processor's"
        for flags in (END, END, BEGIN, BEGIN):
            array.hand_over(to_device=flags == END)
            expected.append((0, flags | READ | WRITE))
            assert synchronised == expected, "each time"
        for sync, flags in ((array[1:].sync_to_device, END), (array.sync_from_device, BEGIN), (array.free, END)):
            sync()
            expected.append((0, flags | READ | WRITE))
            assert synchronised == expected
        array.sync_to_device()
        array.free()  # twice is fine
        assert synchronised == expected

    given = replace(FORM, coherent=False)
    ours = replace(given, writable=True)
    address = Descriptor(kind=packets.ADDRESS, sequence=0x1000)
    for course, sent in (
        (reads, (geometry(given), SLOTS, frame(1, 0), frame(0, 1))),
        (writes, (geometry(ours), SLOTS, GRANT)),
        (holds, (geometry(ours), SLOTS, address)),
    ):
        synchronised.clear()
        manager.answers(*sent)
        used(client, manager, course)


@BOTH
@pytest.mark.parametrize("problem", [errno.ENOTTY, errno.EIO])
def test_ordinary_memory_needs_no_synchronising_and_what_cannot_be_synchronised_goes_back(
    client: Callable[..., Any], manager: Manager, monkeypatch: pytest.MonkeyPatch, problem: int
) -> None:
    def ioctl(*_: Any) -> None:
        raise OSError(problem, os.strerror(problem))

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    manager.answers(geometry(replace(FORM, coherent=False)), SLOTS, frame(1, 0))

    async def course(board: Any) -> Any:
        stream = board.stream("camera", HUNG)
        try:
            return (await now(stream.read())).tolist()
        except OSError as error:  # not pytest.raises, which keeps what was read
            return error.errno
        finally:
            assert manager.got().kind == packets.RELEASE

    assert used(client, manager, course) == (problem if problem == errno.EIO else [[10, 11, 12], [13, 14, 15]])


LOOKS = (
    "all", "any", "argmax", "argsort", "astype", "byteswap", "clip", "conj", "copy", "cumsum", "diagonal", "dumps",
    "flatten", "item", "max", "mean", "min", "nonzero", "prod", "ravel", "round", "squeeze", "std", "sum",
    "tobytes", "tolist", "trace", "transpose", "var", "view", "__copy__", "__dlpack__", "__reduce__",
)  # fmt: skip


def test_whatever_looks_at_the_bytes_of_a_frame_that_was_given_back_is_refused(manager: Manager) -> None:
    manager.answers(geometry(), SLOTS, frame(1, 4))

    async def course(board: Any) -> None:
        held = board.stream("camera", HUNG).read()
        kept = held.copy()
        held.release()
        assert held.released
        for name in LOOKS:
            with pytest.raises(
                FrameReleased, match=r"frame 4 of 'camera' was given back; keep a copy\(\) of what you need"
            ):
                getattr(held, name)()
        with pytest.raises(FrameReleased):
            held[0]
        with pytest.raises(FrameReleased):
            held + 1
        with pytest.raises(FrameReleased):
            np.concatenate([held, kept])
        assert (repr(held), str(held)) == ("<frame 4 of 'camera', given back>",) * 2
        assert held._repr_png_() is None
        assert kept.tolist() == [[10, 11, 12], [13, 14, 15]]

    used(Board, manager, course)


@BOTH
@pytest.mark.parametrize("what", ["memory", "a window"])
@pytest.mark.parametrize(
    ("board_waits", "options", "waits"), [(HUNG, {"timeout": 0.125}, "0.125"), (0.125, {}, "0.125")]
)
def test_what_does_not_come_is_a_time_out(
    client: Callable[..., Any], manager: Manager, what: str, board_waits: float, options: Any, waits: str
) -> None:
    manager.answers(*((geometry(), SLOTS) if what == "memory" else ()))

    async def course(board: Any) -> None:
        board.timeout = board_waits
        with pytest.raises(Timeout, match=rf"^{what}: the manager did not answer within {re.escape(waits)} s$"):
            await now(
                board.registers.window("edge", **options) if what == "a window" else board.allocate(64, **options)
            )

    used(client, manager, course)


@BOTH
@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"", "the configuration manager hung up on the data socket"),
        (
            packets.encode_window(packets.WindowPages(0, 64, True, "prr0", "edge", "camera", "edge", "")),
            "the manager's answer has no pages",
        ),
    ],
)
def test_a_manager_that_gives_no_pages_is_lost(
    client: Callable[..., Any], manager: Manager, answer: bytes, says: str
) -> None:
    manager.answers(*([answer] if answer else []))

    async def course(board: Any) -> None:
        if not answer:
            threading.Thread(target=manager.hang_up).start()
        with pytest.raises(ConnectionLost, match=f"^{says}$"):
            await now(board.registers.window("edge", timeout=HUNG))

    used(client, manager, course)

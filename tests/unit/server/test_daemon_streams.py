# SPDX-License-Identifier: Apache-2.0
"""Streams at the daemon's sockets: single frames, subscribers, clients of the data socket, and settings."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zmq
from daemon_thread import Daemon, Subscriber, daemon
from data_client import Client
from manager_process import patient, stalled, until

from cm.server.rights.model import Access
from cm.wire import plane_packets as packets
from cm.wire.encode import decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import ErrorInfo, FrameInfo, Reply, Status, StreamStatus
from cm.wire.plane_packets import Open, Purpose

FRAME = 48 * 64
PICTURE = bytes(index % 251 for index in range(FRAME))


@pytest.fixture(scope="module")
def shared() -> Iterator[Daemon]:
    with daemon(["--rate", "200"]) as made:
        yield made


@pytest.fixture
def camera(shared: Daemon) -> Daemon:
    """A daemon in the default mode, freshly entered, so that all streams have the schema's settings."""
    shared.load("loopback")
    shared.load("default")
    return shared


@pytest.fixture
def loop(shared: Daemon) -> Daemon:
    """A daemon that loops small frames from `to_pl` back to `from_pl`."""
    shared.load("default")
    shared.load("loopback")
    for name in ("to_pl", "from_pl"):
        shared.done(ConfigureStream(name, shape=(48, 64), force=True))
    return shared


@pytest.fixture
def flowing(loop: Daemon) -> Iterator[Daemon]:
    """The same with `from_pl` open, so that the hardware takes what is written."""
    loop.done(ConfigureStream("from_pl", enable=True))
    yield loop
    loop.done(ConfigureStream("from_pl", automatic=True))


@pytest.fixture
def client() -> Iterator[Callable[..., Client]]:
    """Makes clients, which are closed at the end of the test."""
    with contextlib.ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(contextlib.closing(Client(*arguments)))


def write(daemon: Daemon, data: bytes, **more: object) -> Reply:
    return daemon.ask(rq.WriteData("to_pl", data, **more))  # type: ignore[arg-type]


# ---- single frames -----------------------------------------------------------------------------


def test_a_single_frame_comes_with_its_description(camera: Daemon) -> None:
    reply = camera.ask(rq.ReadData("camera", 30.0))
    info = reply.body
    assert isinstance(info, FrameInfo)
    assert (info.stream, info.shape, info.dtype, info.length) == ("camera", (480, 640), "uint8", 480 * 640)
    assert (info.config_name, info.mode) == ("camera", "default")
    assert len(reply.payload[0]) == info.length
    later = camera.done(rq.ReadData("camera", 30.0))
    assert later.sequence > info.sequence
    assert later.timestamp_ns > info.timestamp_ns


def test_the_only_stream_of_a_direction_needs_no_name(flowing: Daemon) -> None:
    assert flowing.done(rq.WriteData("", PICTURE)).stream == "to_pl"
    code, message = flowing.refused(rq.ReadData("", 1.0))
    assert (code, "camera, from_pl" in message) == ("unknown_stream", True), message


@pytest.mark.parametrize(("asked", "waited"), [(0.01, "0.01"), (0.0, "1")])
def test_a_frame_that_does_not_come_is_a_timeout(loop: Daemon, asked: float, waited: str) -> None:
    code, message = loop.refused(rq.ReadData("from_pl", asked))
    assert (code, f"'from_pl' gave no frame within {waited} s" in message) == ("timeout", True), message


def test_a_written_frame_that_the_hardware_does_not_take_is_a_timeout_and_its_slot_stays_with_it(
    loop: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.streams.over_zmq._WRITE_TIMEOUT", 0.05)
    stuck = [error for error in (write(loop, PICTURE).error for _ in range(4)) if error is not None]
    assert {error.code for error in stuck} == {"timeout"}
    assert stuck[0].message == (
        "stream 'to_pl': the hardware took no data for 0 s; is anything reading the output, and is the region coupled?"
    )
    monkeypatch.undo()
    loop.done(ConfigureStream("from_pl", enable=True))  # it takes them now, and those that were told are not again
    assert write(loop, PICTURE).error is None
    loop.done(ConfigureStream("from_pl", automatic=True))


def test_what_is_written_comes_back_to_every_read_that_waits(loop: Daemon) -> None:
    loop.send(rq.ReadData("from_pl", 60.0))
    loop.send(rq.ReadData("from_pl", 60.0))
    loop.send(rq.WriteData("to_pl", PICTURE))
    replies = [loop.reply() for _ in range(3)]
    assert [reply.error for reply in replies] == [None] * 3
    assert [bytes(reply.payload[0]) for reply in replies if reply.payload] == [PICTURE] * 2


def test_a_frame_that_is_shorter_than_its_shape_comes_as_bytes(loop: Daemon) -> None:
    loop.done(ConfigureStream("from_pl", dtype="uint16", force=True))
    loop.send(rq.ReadData("from_pl", 60.0))
    loop.send(rq.WriteData("to_pl", PICTURE))
    (info,) = [reply.body for reply in (loop.reply(), loop.reply()) if reply.payload and bytes(reply.payload[0])]
    assert (info.stream, info.shape, info.dtype) == ("from_pl", (FRAME,), "uint8")  # type: ignore[union-attr]


def test_written_frames_are_numbered_and_counted(flowing: Daemon) -> None:
    numbers = [write(flowing, PICTURE).body.sequence for _ in range(6)]  # type: ignore[union-attr]
    assert numbers == list(range(numbers[0], numbers[0] + 6))
    assert not any(map(bytes, write(flowing, PICTURE).payload))  # what was sent does not come back
    assert flowing.stream("to_pl").frames == 7


@pytest.mark.parametrize(
    ("request_", "code", "words"),
    [
        (rq.WriteData("to_pl", b"1"), "invalid_request", "takes frames of 48×64 uint8, 3072 bytes; this one has 1"),
        (rq.WriteData("from_pl", PICTURE), "invalid_request", "cannot be used the other way"),
        (rq.ReadData("to_pl", 1.0), "invalid_request", "cannot be used the other way"),
        (rq.ReadData("from_p", 1.0), "unknown_stream", "did you mean 'from_pl'?"),
        (rq.DescribeData("from_p"), "unknown_stream", "did you mean 'from_pl'?"),
        (ConfigureStream("from_p", slots=3), "unknown_stream", "did you mean 'from_pl'?"),
    ],
)
def test_impossible_requests_are_refused(loop: Daemon, request_: rq.Request, code: str, words: str) -> None:
    found, message = loop.refused(request_)
    assert (found, words in message) == (code, True), message


def test_a_transfer_that_fails_is_reported_to_its_writer_and_in_the_status(flowing: Daemon) -> None:
    write(flowing, PICTURE)
    before = flowing.stream("to_pl")
    flowing.board.control.inject("dma_error", "to_pl")
    reply = write(flowing, PICTURE)
    assert reply.error is not None
    assert (reply.error.code, "stream 'to_pl': the DMA reported Input/output error" in reply.error.message) == (
        "transfer_failed",
        True,
    )
    state = flowing.stream("to_pl")
    assert state.errors == 1
    assert state.last_error is not None
    assert write(flowing, PICTURE).error is None
    after = flowing.stream("to_pl")
    assert (after.frames - before.frames, after.errors - before.errors) == (1, 1)


def test_writes_without_a_free_slot_wait_and_too_many_are_refused(loop: Daemon) -> None:
    loop.done(ConfigureStream("to_pl", slots=2))
    for _ in range(36):  # nothing reads the loop's end, so the hardware takes none of them
        loop.send(rq.WriteData("to_pl", PICTURE))
    refused = [loop.reply().error for _ in range(2)]
    said = "stream 'to_pl': 32 frames wait already"
    assert {(error.code, said in error.message) for error in refused if error} == {("busy", True)}
    loop.send(ConfigureStream("from_pl", enable=True))
    codes = [reply.error.code for reply in (loop.reply() for _ in range(35)) if reply.error]
    assert set(codes) <= {"timeout"}, "those that the hardware had may have waited too long"
    assert len(codes) <= 2
    loop.done(ConfigureStream("from_pl", automatic=True))


def test_a_stream_that_a_read_waits_for_is_changed_by_force_alone(loop: Daemon) -> None:
    loop.done(ConfigureStream("from_pl", slots=3))
    loop.send(rq.ReadData("from_pl", 600.0))
    assert loop.refused(ConfigureStream("from_pl", slots=4)) == (
        "busy", "stream 'from_pl' is in use; close its readers, or force the change",
    )  # fmt: skip
    assert loop.done(ConfigureStream("from_pl", slots=3))  # changes nothing
    loop.send(ConfigureStream("from_pl", slots=4, force=True))
    assert sorted(reply.error.code if reply.error else "" for reply in (loop.reply() for _ in range(2))) == [
        "", "stream_stopped",
    ]  # fmt: skip


def test_a_waiting_read_ends_when_its_region_changes(loop: Daemon) -> None:
    loop.send(rq.ReadData("from_pl", 600.0))
    loop.send(rq.ChangeMode("camera", "loopback_edge"))
    errors = [error for error in (loop.reply().error for _ in range(2)) if error]
    assert [(error.code, error.message) for error in errors] == [
        ("stream_stopped", "stream 'from_pl' was stopped before a frame came")
    ]


def test_waiting_writes_end_when_their_region_changes(loop: Daemon) -> None:
    for _ in range(6):  # more than there are slots: the last wait in the daemon
        loop.send(rq.WriteData("to_pl", PICTURE))
    loop.send(rq.ChangeMode("camera", "loopback_edge"))
    errors = [error for error in (loop.reply().error for _ in range(7)) if error]
    assert len(errors) == 6
    stopped = ("stream_stopped", "stream 'to_pl' was stopped before the frame was taken")
    assert [(error.code, error.message) for error in errors].count(stopped) >= 2
    assert {error.code for error in errors} <= {"stream_stopped", "timeout"}


# ---- subscribers ---------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", [b"cm_stream/camera", b"cm_data_read", b"cm_read_data"])
def test_frames_are_published_to_subscribers(camera: Daemon, topic: bytes) -> None:
    seen = Subscriber(camera, topic)
    found = [frames for event, frames in (seen.frames() for _ in range(30)) if isinstance(event, FrameInfo)]
    assert len(found) >= 2
    assert {frames[0] for frames in found} == {topic}
    assert {len(frames[2]) for frames in found} == {480 * 640}
    assert camera.stream("camera").open
    seen.close()
    until(lambda: not camera.stream("camera").open)


def test_frames_that_a_subscriber_does_not_take_are_dropped_and_counted(camera: Daemon) -> None:
    lazy = camera.connect(zmq.SUB, "pub")
    lazy.subscribe(b"cm_stream/camera")
    until(lambda: camera.stream("camera").overruns)
    assert camera.stream("from_pl").overruns == 0
    lazy.close(linger=0)


def test_a_subscriber_gets_the_frames_of_the_next_mode_in_their_shape(camera: Daemon) -> None:
    seen = Subscriber(camera, b"cm_stream/camera")
    seen.until(FrameInfo, lambda info: info.mode == "default")
    camera.load("colorise")
    info = seen.until(FrameInfo, lambda info: info.mode == "colorise")
    assert (info.shape, info.length) == ((480, 640, 3), 480 * 640 * 3)
    seen.close()


# ---- the data socket -------------------------------------------------------------------------------


def test_a_reader_gets_slots_once_and_frames_that_it_gives_back(camera: Daemon, client: Callable[..., Client]) -> None:
    reader = client(camera, Open("camera", depth=3))
    geometry = reader.geometry()
    assert (geometry.shape, geometry.depth, geometry.stream) == ((480, 640), 3, "camera")
    assert (geometry.config_name, geometry.mode, geometry.writable) == ("camera", "default", False)
    last = -1
    for _ in range(5):
        head, _, _ = reader.next(packets.FRAME)
        assert (head.length, head.sequence > last) == (480 * 640, True)
        last = head.sequence
        reader.send(head, packets.RELEASE)
    (told,) = camera.stream("camera").clients
    assert (told.pid, told.depth, told.writes) == (os.getpid(), 3, False)
    reader.close()
    until(lambda: not camera.stream("camera").open)


def test_a_writer_fills_the_slots_that_it_is_granted(loop: Daemon, client: Callable[..., Client]) -> None:
    writer = client(loop, Open("to_pl", Purpose.WRITE, depth=2))
    geometry = writer.geometry()
    assert (geometry.writable, geometry.frame_length, geometry.depth) == (True, FRAME, 2)
    _, _, fds = writer.next(packets.SLOTS)
    loop.send(rq.ReadData("from_pl", 60.0))
    until(lambda: loop_is_open(loop, "from_pl"))
    head, _, _ = writer.next(packets.GRANT)
    for fd in fds:
        os.pwrite(fd, PICTURE, 0)
        os.close(fd)
    writer.send(head._replace(length=FRAME), packets.SUBMIT)
    assert bytes(loop.reply().payload[0]) == PICTURE
    writer.next(packets.DONE)


def loop_is_open(daemon: Daemon, name: str) -> bool:
    """Ask on a separate socket: the daemon's is waiting for another reply."""
    seen = Subscriber(daemon)
    found = any(stream.name == name and stream.open for stream in seen.first.streams)
    seen.close()
    return found


@pytest.mark.parametrize(
    ("wanted", "code", "words"),
    [
        (Open("camra"), "unknown_stream", "did you mean 'camera'?"),
        (Open("to_pl"), "invalid_request", "cannot be used the other way"),
        (Open("camera", Purpose.WRITE), "invalid_request", "cannot be used the other way"),
        (Open("", Purpose.ECHO, length=0), "invalid_request", "an echo has at least one byte"),
        (Open("", Purpose.ECHO, length=1 << 40), "busy", "memory for masters in the PL and echoes is "),
        (b"x" * 40, "invalid_request", "must be an OPEN"),
        (b"short", "invalid_request", "at least 32 bytes"),
    ],
)
def test_impossible_requests_of_a_connection_are_refused(
    camera: Daemon, client: Callable[..., Client], wanted: Open | bytes, code: str, words: str
) -> None:
    found, message = client(camera, wanted).refusal()
    assert (found, words in message) == (code, True), message


def test_an_echo_gives_back_what_it_is_given(camera: Daemon, client: Callable[..., Client]) -> None:
    before = memory_of_echoes()
    echo = client(camera, Open("", Purpose.ECHO, length=100))
    geometry = echo.geometry()
    assert (geometry.frame_length, geometry.slot_length, geometry.depth) == (100, 4096, 2)
    head, _, _ = echo.next(packets.GRANT)
    echo.send(head._replace(length=100), packets.SUBMIT)
    done, _, _ = echo.next(packets.DONE)
    assert done.slot == head.slot
    assert client(camera, Open("", Purpose.ECHO, length=100)).geometry().depth == 2  # beside it
    with contextlib.closing(client(camera, Open("", Purpose.ECHO, length=5000, depth=99))) as other:
        geometry = other.geometry()
        assert (geometry.slot_length, geometry.depth, geometry.shape, geometry.writable) == (8192, 16, (5000,), True)
        assert memory_of_echoes() == before + 20
    until(lambda: memory_of_echoes() == before + 4)


def memory_of_echoes() -> int:
    """The slots that the daemon has for them."""
    found = 0
    for path in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # it was closed meanwhile
            found += "memfd:cm-echo" in str(path.readlink())
    return found


def test_a_reader_that_leaves_keeps_no_stream_open(camera: Daemon, client: Callable[..., Client]) -> None:
    reader = client(camera, Open("camera", depth=2))
    held, _, _ = reader.next(packets.FRAME)
    reader.send(packets.Descriptor(), packets.LEAVE)
    until(lambda: not camera.stream("camera").open)
    reader.send(held, packets.RELEASE)


def test_registers_are_read_by_name_without_a_request(camera: Daemon, client: Callable[..., Client]) -> None:
    camera.done(rq.WriteReg((rq.RegWrite("led", 0x15),)))
    reader = client(camera, Open("", Purpose.REGISTERS))
    reader.next(packets.REGISTERS)

    def asked(name: str) -> packets.Descriptor:
        reader.socket.send(packets.Descriptor(kind=packets.READ, sequence=77).pack() + name.encode())
        return reader.next(packets.VALUE, packets.ELSEWHERE)[0]

    until(lambda: asked("led").kind == packets.VALUE)  # published once somebody has asked
    answer = asked("led.blink")
    assert (answer.kind, answer.sequence, answer.length) == (packets.VALUE, 77, 1)
    answer = asked("nothing")
    assert (answer.kind, answer.sequence) == (packets.ELSEWHERE, 77)
    reader.send(packets.Descriptor(), packets.PING)
    assert reader.socket.recv(packets.PACKET_MAX) == b""  # who breaks the rules is hung up on


def test_registers_are_lent_as_memory_until_their_module_goes(camera: Daemon, client: Callable[..., Client]) -> None:
    camera.load("edge_detection")
    user = client(camera, Open("edge", Purpose.WRITABLE_WINDOW, exclusive=True))
    _, data, fds = user.next(packets.WINDOW)
    pages = packets.decode_window(data)
    assert (pages.region, pages.module, pages.mode, pages.writable) == ("prr0", "edge", "edge_detection", True)
    (told,) = camera.status.windows
    assert (told.module, told.address, told.length) == ("edge", pages.address, pages.length)
    assert (told.writes, told.exclusive, told.pid) == (True, True, os.getpid())
    assert client(camera, Open("edge", Purpose.WRITABLE_WINDOW)).refusal()[0] == "held_by"
    camera.done(rq.ChangeMode("camera", "default", lease=pages.lease))
    assert packets.decode_revoked(user.next(packets.REVOKED)[1]) == (1, "camera", "default")
    assert camera.status.windows == ()
    assert user.socket.recv(packets.PACKET_MAX) == b""
    for fd in fds:  # whose end would give the pages back
        os.close(fd)


def test_a_writer_needs_the_lease_that_another_client_holds(loop: Daemon, client: Callable[..., Client]) -> None:
    lease = loop.done(rq.TakeLease("region:prr1", holder="me"))
    code, message = client(loop, Open("to_pl", Purpose.WRITE)).refusal()
    assert (code, "me" in message) == ("held_by", True)
    assert write(loop, PICTURE).error.code == "held_by"  # type: ignore[union-attr]
    assert loop.refused(ConfigureStream("to_pl", slots=3))[0] == "held_by"
    assert client(loop, Open("to_pl", Purpose.WRITE, lease=lease.id)).geometry().writable
    client(loop, Open("from_pl")).geometry()  # reading holds nothing up
    loop.done(ConfigureStream("from_pl", backpressure=True, force=True, lease=lease.id))
    assert client(loop, Open("from_pl")).refusal()[0] == "held_by"
    loop.done(rq.ReleaseLease(lease.id))


def test_who_may_only_look_opens_no_writer(client: Callable[..., Client], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cm.server.connections.credentials", lambda _: (os.getpid(), 65534, 65534))
    with daemon(access=Access(local=("observe",))) as made:
        made.load("loopback")
        code, message = client(made, Open("to_pl", Purpose.WRITE)).refusal()
        assert (code, "to_pl" in message) == ("forbidden", True), message
        assert client(made, Open("from_pl")).geometry().stream == "from_pl"


# ---- settings --------------------------------------------------------------------------------------


def settings(state: object) -> tuple[object, ...]:
    return tuple(getattr(state, name) for name in ("shape", "dtype", "cyclic", "backpressure", "stride", "limit"))


def test_settings_are_reported_and_last_until_the_mode_changes(loop: Daemon) -> None:
    told = loop.done(ConfigureStream("from_pl", shape=(8, 16), dtype="uint16", slots=6, rate=12.5, backpressure=True))
    assert settings(told) == ((8, 16), "uint16", False, True, 0, 12.5)
    assert told.slots == 6
    assert settings(loop.stream("from_pl")) == settings(told)
    loop.load("loopback")
    assert settings(loop.stream("from_pl")) == settings(told)
    loop.load("loopback_edge")
    assert settings(loop.stream("from_pl")) == ((480, 640), "uint8", False, False, 0, 0.0)


def test_a_setting_for_a_stream_that_is_held_applies_after_the_change(tmp_path: Path) -> None:
    with daemon(schemas=patient(tmp_path)) as made:
        made.load("default")
        made.done(ConfigureStream("camera", enable=True))
        other = made.connect(zmq.DEALER, "req")
        with stalled(made.board):
            made.send(rq.ChangeMode("camera", "edge_detection"))
            until(lambda: not loop_is_open(made, "camera"))
            other.send_multipart([b"", *encode_request(ConfigureStream("camera", slots=5, force=True))])
            told = decode_reply(other.recv_multipart()[1:])
        assert isinstance(told.body, StreamStatus)
        assert (told.body.slots, told.body.open) == (5, False)
        assert made.reply().error is None
        until(lambda: made.stream("camera").open)


def test_a_stream_runs_as_long_as_it_is_enabled(camera: Daemon) -> None:
    assert camera.done(ConfigureStream("camera", enable=True)).open
    until(lambda: camera.stream("camera").frames > 3)
    code, message = camera.refused(ConfigureStream("camera", slots=5))
    assert (code, "in use" in message) == ("busy", True)
    assert camera.done(ConfigureStream("camera", slots=5, force=True)).slots >= 5
    assert not camera.done(ConfigureStream("camera", enable=False)).open
    code, message = camera.refused(rq.ReadData("camera", 1.0))
    assert (code, "was stopped" in message) == ("stream_stopped", True)
    camera.done(ConfigureStream("camera", automatic=True))
    assert camera.ask(rq.ReadData("camera", 30.0)).error is None


def test_what_the_channel_refuses_changes_nothing_and_no_reader_notices(
    camera: Daemon, client: Callable[..., Client]
) -> None:
    before = settings(camera.stream("camera"))
    wrong = ConfigureStream("camera", shape=(1 << 27,), enable=True, backpressure=True, force=True)
    for reader in (None, client(camera, Open("camera"))):
        code, message = camera.refused(wrong)
        assert (code, "134217728 bytes" in message) == ("invalid_request", True), message
        assert settings(camera.stream("camera")) == before
        if reader is not None:
            assert reader.next(packets.FRAME, packets.STOPPED)[0].kind == packets.FRAME
            reader.close()
    until(lambda: not camera.stream("camera").open)


def test_a_stride_keeps_lines_apart_in_the_slot_and_together_over_zeromq(loop: Daemon) -> None:
    for name in ("to_pl", "from_pl"):
        assert loop.done(ConfigureStream(name, stride=128)).stride == 128
    loop.send(rq.ReadData("from_pl", 60.0))
    loop.send(rq.WriteData("to_pl", PICTURE))
    replies = [loop.reply() for _ in range(2)]
    assert [bytes(reply.payload[0]) for reply in replies if reply.payload] == [PICTURE]


def test_a_cyclic_frame_is_repeated(flowing: Daemon) -> None:
    assert flowing.done(ConfigureStream("to_pl", cyclic=True)).cyclic
    seen = Subscriber(flowing, b"cm_stream/from_pl")
    write(flowing, PICTURE)
    for _ in range(3):
        seen.until(FrameInfo)
    seen.close()
    flowing.done(ConfigureStream("to_pl", cyclic=False, force=True))


# ---- boards that go ------------------------------------------------------------------------------------


def failure(status: Status) -> ErrorInfo | None:
    """Why the camera's stream ended."""
    return next((stream.last_error for stream in status.streams if stream.name == "camera"), None)


def test_a_board_that_stops_answering_is_reported_and_taken_up_again(
    client: Callable[..., Client], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("CM_SIM_TIMEOUT", "3")  # for every node: an interrupt's register is waited for as well
    with daemon(["--rate", "200"]) as made:
        made.load("default")
        reader = client(made, Open("camera", depth=2))
        held = [reader.next(packets.FRAME)[0] for _ in range(2)]
        seen = Subscriber(made)
        os.kill(made.board.pid, signal.SIGSTOP)
        try:
            for head in held:  # a slot that is given back goes to the board
                reader.send(head, packets.RELEASE)
            told = failure(seen.first) or failure(
                seen.until(Status, failure)
            )  # on a busy machine it may have come before
            assert told is not None
            assert (told.code, "'camera' ended: Connection timed out" in told.message) == ("device_error", True)
            assert "stream camera ended: Connection timed out" in caplog.messages
            assert made.refused(rq.ReadData("camera", 1.0))[0] == "timeout"
            assert made.refused(rq.ReadData("from_pl", 1.0))[0] == "timeout"  # which was closed
            silent = "stream 'from_pl': the board does not answer; the stream resumes when it does"
            assert made.refused(rq.ReadData("from_pl", 1.0)) == ("timeout", silent)
            assert made.done(ConfigureStream("from_pl", slots=9)).slots == 9
        finally:
            os.kill(made.board.pid, signal.SIGCONT)
        until(lambda: made.ask(ConfigureStream("from_pl", enable=True)).error is None)
        reader.next(packets.STOPPED)
        assert reader.geometry().stream == "camera"
        reader.next(packets.FRAME)
        seen.close()


def test_a_board_that_was_started_anew_holds_nothing() -> None:
    with daemon() as made:
        made.load("default")
        made.done(rq.WriteReg((rq.RegWrite("focus", 5),)))
        read = rq.ReadReg(("focus",))
        assert [made.done(read).values[0].value for _ in range(3)] == [5] * 3
        seen = Subscriber(made)
        made.board.kill()
        assert made.refused(read)[0] == "device_gone"
        made.board.start()
        told = seen.until(Status, lambda status: not status.config_name)
        assert told.streams == ()
        seen.close()
        assert made.refused(read)[0] == "nothing_loaded"
        made.load("default")
        assert made.done(read).values[0].value == 1
        assert made.ask(rq.ReadData("camera", 60.0)).error is None

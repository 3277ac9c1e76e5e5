# SPDX-License-Identifier: Apache-2.0
"""Flows of the clients' core, run without sockets: what they wait for, and when they have enough."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from cm.client.core import calls, memory, registers, uploads
from cm.client.core.change import ChangeWatch, loading
from cm.client.core.events import InterruptEvents, RegisterEvents, StatusEvents
from cm.client.core.flow_effects import DEFAULT, Ask, AskBeside, Flow, Receive
from cm.client.core.generations import FirstAfter, Written
from cm.client.core.remote_stream import Arrivals, NewestReader, PublishedReader, Wanted
from cm.client.errors import RequestBusy, RequestInvalid, request_error
from cm.errors import InvalidRequest, Timeout
from cm.wire.encode import encode_irq, encode_registers, encode_status, encoded
from cm.wire.messages import requests as rq
from cm.wire.messages import status as told
from cm.wire.messages.status import ChangeInfo, ErrorInfo, Progress, Reply, Status

CALL = calls.load("camera", "edge", wait=True, queue=True, force=False, lease="")
UNDER_WAY = Status("camera", "", fpga_busy=True, progress=Progress(7, "camera", "edge", "load", "prr0", 1, 2, 0.5))
ENDED = Status("camera", "edge", last_change=7)


def message(status: Status) -> list[Any]:
    return list(encode_status(status))


@pytest.mark.parametrize("overtaken", [False, True], ids=["in order", "reply first"])
def test_a_load_with_progress_waits_for_what_is_missing_and_for_nothing_more(overtaken: bool) -> None:
    told: list[Progress] = []
    flow = loading(CALL, None, object(), told.append)  # type: ignore[arg-type]
    assert isinstance(next(flow), Receive)
    asked = flow.send(message(Status("camera", "default", last_change=6)))
    assert isinstance(asked, AskBeside)
    if not overtaken:
        for status in (UNDER_WAY, ENDED):
            asked.take(message(status))
    waits: list[Any] = [message(UNDER_WAY), message(ENDED)] if overtaken else []
    answer: Any = ChangeInfo(7, done=True, seconds=0.25)
    while waits:
        assert isinstance(flow.send(answer), Receive)
        answer = waits.pop(0)
    with pytest.raises(StopIteration) as end:  # it waits for nothing more
        flow.send(answer)
    assert end.value.value == 0.25
    assert [progress.step for progress in told] == ["load"]


def test_a_manager_without_uploads_gets_everything_in_one_message() -> None:
    flow = uploads.upload(bytes(10 << 20))
    next(flow)
    with pytest.raises(StopIteration) as ended:
        flow.throw(RequestInvalid(ErrorInfo("invalid_request", "unknown topic 'cm_upload'; topics are cm_status")))
    assert ended.value.value == ""


@pytest.mark.parametrize("length", [0, 1, uploads.PART, 2 * uploads.PART + 5])
def test_an_upload_is_sent_in_parts_that_say_where_they_belong(length: int) -> None:
    data = np.random.default_rng(1).bytes(length)
    flow, sent = uploads.upload(data), b""
    name, waits = went(flow, *[told.UploadInfo("", length, 0)] * max(1, -(-length // uploads.PART)))
    for part in [wait.request for wait in waits]:
        assert (part.id, part.length, part.offset) == (name, length, len(sent))
        assert len(part.data) <= uploads.PART
        sent += part.data
    assert sent == data
    assert name
    assert name != went(uploads.upload(b""), told.UploadInfo("", 0, 0))[0]


OLD = RequestInvalid(ErrorInfo("invalid_request", "unknown topic 'cm_upload'; topics are cm_status"))
TAKEN = told.UploadInfo("", 0, 0)


def test_what_is_too_long_for_a_message_is_named_in_it_by_its_upload(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("config: {}")
    (tmp_path / "a.bit").write_bytes(bytes(uploads.PART))
    (tmp_path / "b.bit").write_bytes(bytes(uploads.WHOLE - uploads.PART))
    files = [tmp_path / "a.bit", tmp_path / "b.bit"]
    whole, asked = went(uploads.provision(tmp_path / "a.yaml", files, "l"))
    assert (whole.request.files, asked) == (
        (rq.File("a.bit", files[0].read_bytes()), rq.File("b.bit", files[1].read_bytes())),
        [],
    )
    files[1].write_bytes(bytes(uploads.WHOLE - uploads.PART + 1))
    call, asked = went(uploads.provision(tmp_path / "a.yaml", files, "l"), *[TAKEN] * 5)
    assert [file.name for file in call.request.files] == ["a.bit", "b.bit"]
    assert not any(file.data for file in call.request.files)
    assert [file.upload for file in call.request.files] == list(dict.fromkeys(wait.request.id for wait in asked))
    assert call.request.lease == "l"
    forgotten = went(uploads.discarding(call), TAKEN, TAKEN)[1]
    assert [wait.request for wait in forgotten] == [rq.Upload(file.upload, discard=True) for file in call.request.files]
    assert went(uploads.provision(tmp_path / "a.yaml", files, "l"), OLD, OLD)[0].request.files == tuple(
        rq.File(file.name, file.read_bytes()) for file in files
    )


def test_a_long_frame_is_uploaded_where_the_manager_takes_uploads() -> None:
    frame = np.arange(uploads.WHOLE + 1).astype(np.uint8)
    whole, asked = went(uploads.write_data("to_pl", frame[1:], "l"))
    assert (bytes(whole.request.data), asked) == (frame[1:].tobytes(), [])
    assert went(uploads.discarding(whole)) == (None, [])
    call, asked = went(uploads.write_data("to_pl", frame, "l"), *[TAKEN] * 5)
    assert call.request == rq.WriteData("to_pl", b"", lease="l", upload=asked[0].request.id)
    assert [wait.request for wait in went(uploads.discarding(call), TAKEN)[1]] == [
        rq.Upload(call.request.upload, discard=True)
    ]
    assert bytes(went(uploads.write_data("to_pl", frame, "l"), OLD)[0].request.data) == frame.tobytes()
    assert went(uploads.discarding(calls.status())) == (None, [])


@pytest.mark.parametrize(
    ("parts", "refusal"),
    [(0, "no more than 64 MiB"), (1, "unknown topic 'cm_upload'")],
    ids=["of the first part", "of a later part"],
)
def test_a_refusal_of_an_upload_is_the_callers(parts: int, refusal: str) -> None:
    error = RequestInvalid(ErrorInfo("invalid_request", refusal))
    with pytest.raises(RequestInvalid, match=refusal):
        went(uploads.upload(bytes(2 * uploads.PART)), *[TAKEN] * parts, error)


def test_a_picture_is_sent_again_in_the_streams_format_if_it_was_refused_for_it() -> None:
    picture = np.arange(6, dtype=np.uint8).reshape(1, 2, 3)
    form = request_error(ErrorInfo("pixel_format", "yuv"))
    call, asked = went(uploads.recoded(form, "to_pl", picture, "l"), replace(STREAM, format="bgr"))
    assert [wait.request for wait in asked] == [rq.DescribeData("to_pl")]
    assert (bytes(call.request.data), call.request.lease) == (bytes([2, 1, 0, 5, 4, 3]), "l")
    with pytest.raises(RequestBusy):
        went(uploads.recoded(request_error(ErrorInfo("busy", "")), "to_pl", picture, "l"))


LISTED = told.ConfigInfo(names=("camera",), entries=(told.ConfigEntry("camera"),))
STREAM, MEMORY = told.StreamStatus("to_pl", "dma0", "mm2s"), told.MemoryInfo("table", 0x1000, 64)
LEASE = told.LeaseInfo("x", "board", exclusive=True, seconds=3.0)
SENT = told.FrameInfo("to_pl", 4, 5, 6)
CALLS: list[tuple[calls.Call[Any], rq.Request, Any]] = [  # more: ASKED of test_client_requests
    (calls.status(), rq.ReadStatus(), Status("camera", "edge")),
    (calls.upload(rq.Upload("a", 9)), rq.Upload("a", 9), told.UploadInfo("a", 9, 0)),
    (calls.describe_stream("to_pl"), rq.DescribeData("to_pl"), STREAM),
    (calls.describe_memory("table"), rq.DescribeData("table"), MEMORY),
    (calls.interrupt("frame_done"), rq.ReadIrq("frame_done"), told.Irq("frame_done", 3, 4)),
    (calls.lease(rq.TakeLease("board")), rq.TakeLease("board"), LEASE),
]


@pytest.mark.parametrize(("call", "request_", "body"), CALLS)
def test_a_call_asks_and_gives_what_was_answered(call: calls.Call[Any], request_: rq.Request, body: Any) -> None:
    assert call.request == request_
    assert call.result(Reply(body)) is body
    with pytest.raises(RequestBusy, match="not now"):
        call.result(Reply(error=ErrorInfo("busy", "not now")))
    with pytest.raises(InvalidRequest, match=f"answered with ProvisionAnswer, not {type(body).__name__}"):
        call.result(Reply(type("ProvisionAnswer", (), {})()))


@pytest.mark.parametrize(
    ("call", "request_", "body", "result"),
    [
        (calls.clients(), rq.ReadStatus(clients=True), Status(clients=(told.ClientStatus("a"),)), 0),
        (calls.config_names(), rq.ListConfigs(), LISTED, LISTED.names),
        (calls.config_entries(), rq.ListConfigs(), LISTED, LISTED.entries),
        (calls.remove_config("camera", "l"), rq.RemoveConfig("camera", "l"), LISTED, LISTED.entries),
        (calls.read_memory("table", 8, 4), rq.ReadData("table", offset=8, length=4), SENT, (SENT, b"")),
    ],
)
def test_some_calls_give_a_part_of_what_was_answered(
    call: calls.Call[Any], request_: rq.Request, body: Any, result: Any
) -> None:
    assert call.request == request_
    assert call.result(Reply(body)) == (result or body.clients)


def test_a_frame_and_a_piece_of_memory_are_the_payload_beside_their_description() -> None:
    call, info = calls.read_data("camera", 1.5), told.FrameInfo("camera", 4, 5, 6, (2, 3), "uint8")
    assert call.request == rq.ReadData("camera", 1.5)
    frame = call.result(Reply(info, payload=(b"abcdef",)))
    assert (frame.tobytes(), frame.shape, frame.info) == (b"abcdef", (2, 3), info)
    assert call.result(Reply(replace(info, length=0, shape=(0,)))).size == 0
    yellow = replace(info, shape=(1, 1, 3), format="bgr")
    assert call.result(Reply(yellow, payload=(b"\0\xff\xff",))).tolist() == [[[255, 255, 0]]]
    as_it_is = calls.read_data("camera", 1.5, raw=True).result(Reply(yellow, payload=(b"\0\xff\xff",)))
    assert as_it_is.tolist() == [[[0, 255, 255]]]
    assert calls.read_memory("table", 0, 3).result(Reply(info, payload=(b"abc",))) == (info, b"abc")


def test_a_stream_is_no_memory() -> None:
    with pytest.raises(InvalidRequest, match=r"'to_pl' is a stream, not a memory: board\.stream\('to_pl'\)"):
        calls.describe_memory("to_pl").result(Reply(STREAM))


REGISTERS = (
    told.RegisterInfo("focus", 0x1000, 32, "rw"),
    told.RegisterInfo("gain", 0x1004, 32, "rw", modes=("edge",), fields=(told.FieldInfo("red", 0, 7),)),
    told.RegisterInfo("blur", 0x1008, 32, "rw", modes=("default",)),
)


def test_registers_and_memories_are_those_of_the_mode() -> None:
    memories = (MEMORY, replace(MEMORY, name="taps", modes=("default",)), replace(MEMORY, name="log", modes=("edge",)))
    config = told.ConfigInfo("camera", mode="edge", registers=REGISTERS, memories=memories)
    assert list(registers.visible(config)) == ["focus", "gain"]
    assert memory.visible(config) == {"table": MEMORY, "log": memories[2]}


@pytest.mark.parametrize(
    ("name", "there"),
    [("focus", True), ("gain.red", True), ("gain", True)]
    + [(none, False) for none in ("gain.", "gain.blue", "blur", "focus.red", ".red", 3, None)],
)
def test_registers_and_their_fields_have_names(name: object, there: bool) -> None:
    info = {register.name: register for register in REGISTERS[:2]}
    assert registers.has(info, name) == there
    assert (name in registers.names(info.values())) == there


@pytest.mark.parametrize(
    ("data", "sent", "form"),
    [
        (np.arange(6, dtype=np.uint8).reshape(1, 2, 3), bytes(range(6)), "rgb"),
        (
            np.arange(12, dtype=np.uint8).reshape(2, 2, 3)[:, :, ::-1],
            bytes([2, 1, 0, 5, 4, 3, 8, 7, 6, 11, 10, 9]),
            "rgb",
        ),
        (np.arange(4, dtype=np.uint8).reshape(1, 1, 4), bytes(range(4)), ""),
        (np.arange(3, dtype=np.uint16).reshape(1, 1, 3), b"\0\0\1\0\2\0", ""),
        (np.arange(3, dtype=np.uint8), bytes(range(3)), ""),
        (bytearray(b"abc"), b"abc", ""),
    ],
)
def test_an_array_of_colours_is_said_to_be_rgb(data: Any, sent: bytes, form: str) -> None:
    request: Any = calls.write_data("to_pl", data, "").request
    assert (bytes(request.data), request.format) == (sent, form)


def test_a_schema_is_sent_with_its_files(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("config: {}")
    (tmp_path / "a.bit").write_bytes(b"abc")
    call = calls.provision(tmp_path / "a.yaml", (tmp_path / "a.bit",), "l")
    assert call.request == rq.Provision("config: {}", (rq.File("a.bit", b"abc"),), lease="l")
    assert call.result(Reply(LISTED)) is LISTED
    (tmp_path / "a.yaml").write_bytes(b"ab\xff")
    with pytest.raises(InvalidRequest, match=r"a\.yaml is no runtime schema: it is not UTF-8 \(.* at byte 2\)"):
        calls.provision(tmp_path / "a.yaml", (), "")


def test_the_seconds_of_a_change_are_those_of_the_status_if_it_was_the_last() -> None:
    ended = replace(ENDED, last_change_seconds=0.5)
    assert (calls.ended(ended, 7), calls.ended(ended, 6)) == (0.5, 0.0)
    with pytest.raises(RequestBusy):
        calls.ended(replace(ended, last_error=ErrorInfo("busy", "")), 7)


class Listened:
    """A subscription: what was left of it."""

    def __init__(self) -> None:
        self.left: list[bytes] = []
        self.closed = False

    def unsubscribe(self, topic: bytes) -> None:
        self.left.append(topic)

    def close(self) -> None:
        self.closed = True


def went(flow: Flow[Any], *answers: Any) -> tuple[Any, list[Any]]:
    """A flow to its end: its value, and what it waited for; an answer that is an error is thrown."""
    waits, given = [], iter(answers)
    try:
        waits.append(next(flow))
        for answer in given:
            waits.append(flow.throw(answer) if isinstance(answer, Exception) else flow.send(answer))
    except StopIteration as end:
        assert not list(given), "it waited for less"
        return end.value, waits
    raise AssertionError(f"it waits for more: {waits[-1]}")


def written(*names: str) -> list[Any]:
    return list(encode_registers(told.RegValues(tuple(told.RegValue(name, 7) for name in names), "camera", "edge", 3)))


def came(name: str, count: int) -> list[Any]:
    return list(encode_irq(told.Irq(name, count, 100 + count)))


@pytest.mark.parametrize(
    ("wanted", "sent", "got"),
    [((), ("zoom",), ("zoom",)), (("focus",), ("zoom", "focus"), ("focus",)), (("focus",), ("zoom",), None)],
)
def test_writes_of_the_registers_that_are_wanted_are_events(
    wanted: tuple[str, ...], sent: tuple[str, ...], got: tuple[str, ...] | None
) -> None:
    listened = Listened()
    events = RegisterEvents(listened, 0.5, wanted)
    known = (told.ConfigInfo("camera", registers=REGISTERS),) if wanted else ()
    assert went(events.opening(), written("focus"), message(ENDED), *known)[0] is None
    assert listened.left == [b"cm_status"]
    if got is None:
        with pytest.raises(Timeout, match=r"nothing came within 0\.5 s"):
            went(events.next(), message(ENDED), written(*sent), None)
        return
    event, waits = went(events.next(2.0), message(ENDED), written(*sent))
    assert [value.name for value in event.values] == list(got)
    assert (event.config_name, event.mode, event.generation) == ("camera", "edge", 3)
    assert all(isinstance(wait, Receive) and wait.subscription is listened for wait in waits)


def test_statuses_are_events_from_the_first_on() -> None:
    events = StatusEvents(Listened(), None)
    assert went(events.next(), written("focus"), message(ENDED))[0] == ENDED
    waited = next(events.next())
    assert isinstance(waited, Receive)
    assert waited.timeout is None


@pytest.mark.parametrize(
    ("since", "before"), [(None, False), (102, False), (101, True), (0, True)], ids=["any", "known", "missed", "first"]
)
def test_an_interrupt_that_came_while_nobody_listened_is_the_first(since: int | None, before: bool) -> None:
    events = InterruptEvents(Listened(), 0.5, "frame_done", since)
    _, waits = went(events.opening(), message(ENDED), told.Irq("frame_done", 2, 102))
    assert isinstance(waits[1], Ask)
    assert waits[1].call.request == rq.ReadIrq("frame_done")
    if before:
        assert went(events.next())[0].count == 2
    event, _ = went(events.next(), came("frame_done", 2), came("loop_done", 3), message(ENDED), came("frame_done", 3))
    assert event == told.Irq("frame_done", 3, 103)
    with pytest.raises(Timeout, match=r"interrupt 'frame_done' did not come within 0\.5 s"):
        went(events.next(), None)


def test_an_interrupt_that_never_came_is_not_the_first() -> None:
    events = InterruptEvents(Listened(), 0.5, "frame_done", 7)
    went(events.opening(), message(ENDED), told.Irq("frame_done", 0, 0))
    assert went(events.next(), came("frame_done", 1))[0].count == 1


def test_a_manager_that_publishes_no_status_is_not_waited_for() -> None:
    with pytest.raises(Timeout, match="the manager published no status within 5 s"):
        went(RegisterEvents(Listened(), 0.5, ()).opening(), None)


def test_a_change_that_was_not_waited_for_ends_with_the_status_that_says_so() -> None:
    listened = Listened()
    watch = ChangeWatch(7, listened)
    assert went(watch.arrived(), written("focus"), message(UNDER_WAY), None)[0] is False
    assert watch.progress == UNDER_WAY.progress
    with pytest.raises(Timeout, match=r"change 7 has not ended within 0\.5 s"):
        went(watch.waiting(0.5), message(replace(ENDED, last_change=6)), None)
    assert not watch.has_ended
    assert went(watch.waiting(None), message(replace(ENDED, last_change_seconds=0.5)))[0] == 0.5
    assert (watch.has_ended, listened.closed) == (True, True)
    assert went(watch.arrived()) == (True, [])


def published(stream: str, sequence: int) -> list[Any]:
    info = told.FrameInfo(stream, sequence, 5, 6, (2, 3))
    return [b"cm_stream/" + stream.encode(), encoded(info), b"abcdef"]


def test_published_frames_are_subscribed_to_and_those_that_are_missing_are_counted() -> None:
    asked: list[tuple[bytes, int]] = []

    def subscribe(topic: bytes, depth: int) -> Listened:
        asked.append((topic, depth))
        return Listened()

    reader = PublishedReader(Wanted("camera", 0.5, depth=9), subscribe)
    frame, waits = went(reader.reading(2.0), STREAM, published("camera2", 1), published("camera", 4))
    assert isinstance(waits[0], Ask)
    assert waits[0].call.request == rq.ConfigureStream("camera")
    assert (frame.tobytes(), frame.sequence, reader.lost, asked) == (b"abcdef", 4, 0, [(b"cm_stream/camera", 9)])
    assert went(reader.reading(2.0), published("camera", 7))[0].sequence == 7
    assert reader.lost == 2
    with pytest.raises(Timeout, match=r"stream 'camera' gave no frame within 0\.5 s"):
        went(reader.reading(0.5), None)
    reader.close()
    with pytest.raises(InvalidRequest, match="'camera' was closed: ask for another"):
        went(reader.opening(), STREAM)
    assert len(asked) == 1


def test_the_newest_frame_is_asked_for_again_while_the_stream_is_stopped() -> None:
    reader = NewestReader(Wanted("camera", None, newest=True))
    stopped = request_error(ErrorInfo("stream_stopped", "a change"))
    nothing = request_error(ErrorInfo("timeout", "no frame"))
    info = told.FrameInfo("camera", 4, 5, 6, (2, 3))
    frame = calls.read_data("camera", 1.0).result(Reply(info, payload=(b"abcdef",)))
    got, waits = went(reader.reading(None), stopped, None, nothing, frame)
    assert got is frame
    assert [type(wait).__name__ for wait in waits] == ["Ask", "Pause", "Ask", "Ask"]
    assert {wait.call.request for wait in waits if isinstance(wait, Ask)} == {rq.ReadData("camera", 5.0)}
    with pytest.raises(RequestBusy):
        went(reader.reading(None), request_error(ErrorInfo("busy", "")))


@pytest.mark.parametrize(("raw", "seen"), [(False, [3, 2, 1]), (True, [1, 2, 3])])
def test_pixels_come_in_rgb_or_as_they_lie_in_memory(raw: bool, seen: list[int]) -> None:
    info = told.FrameInfo("camera", 4, 5, 3, (1, 1, 3), format="bgr")
    asked: Any = next(NewestReader(Wanted("camera", None, newest=True, raw=raw)).reading(None))
    assert asked.call.result(Reply(info, payload=(b"\1\2\3",))).tolist() == [[seen]]
    message = [b"cm_stream/camera", encoded(info), b"\1\2\3"]
    reader = PublishedReader(Wanted("camera", None, raw=raw), lambda *_: Listened())
    assert went(reader.reading(None), STREAM, message)[0].tolist() == [[seen]]


class Numbered(NamedTuple):
    """A frame of a generation, and whether it was given back."""

    generation: int
    released: list[int]

    def release(self) -> None:
        self.released.append(self.generation)


def test_the_frame_after_a_write_is_the_first_of_its_generation() -> None:
    released: list[int] = []
    written = Written(told.RegValues((told.RegValue("focus", 7),), generation=4))
    assert (written, written.generation) == ({"focus": 7}, 4)
    for write in (written, 4):
        wanted = FirstAfter("camera", write, None, 0.0)
        for generation in (0, 3, 4, 5):
            assert wanted.left() is None
            if wanted.has(Numbered(generation, released)):  # type: ignore[arg-type]
                break
        assert generation == 4
    assert released == [0, 3, 0, 3]
    with pytest.raises(Timeout, match=r"stream 'camera' gave no frame of generation 4 within 0 s"):
        FirstAfter("camera", 4, 0.0, None).left()
    assert 0 < (FirstAfter("camera", 4, DEFAULT, 60.0).left() or 0) <= 60
    assert "within 60 s" in str(FirstAfter("camera", 4, DEFAULT, 60.0).nothing())


@pytest.mark.parametrize("write", [-1, True, 1.0, "4", None])
def test_what_is_no_generation_is_refused(write: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"it takes what registers\.write\(\) returned, or a generation"):
        FirstAfter("camera", write, None, None)


def test_what_is_no_frame_on_its_topic_is_refused() -> None:
    half = [b"cm_stream/camera", encoded(told.FrameInfo("camera", 4, 5, 6, (2, 3)))]
    for message, words in (
        (half, "FrameInfo in 2 parts came on a stream's topic"),
        (message_of_another_kind(), "Status in 3 parts came on a stream's topic"),
    ):
        with pytest.raises(InvalidRequest, match=words):
            Arrivals().frame(message)


def message_of_another_kind() -> list[Any]:
    return [*message(ENDED), b""]


@pytest.mark.parametrize("data", [[1, 2], "text", 5])
def test_what_is_no_frame_is_refused_in_words(data: Any) -> None:
    with pytest.raises(InvalidRequest, match=f"stream 'to_pl' takes an array or bytes, not {type(data).__name__}"):
        calls.write_data("to_pl", data, "")

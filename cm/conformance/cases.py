# SPDX-License-Identifier: Apache-2.0
"""What a client is put through: each case asks it for something, plays the manager, and knows the right answer."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from cm.conformance.stage import Play, Stage, Taken
from cm.messages import requests as rq
from cm.wire import cm_pb2 as pb

Answer = Mapping[str, Any]
LARGE = (1 << 64) - 1


def _nothing(_: Stage, __: str) -> None:
    return None


def _all_right(_: list[Taken]) -> str:
    return ""


@dataclass(frozen=True, slots=True)
class Case:
    """`do` is what the client is to do, one after the other; `want` the results; `check` complains of its requests."""

    name: str
    says: str
    do: tuple[Answer, ...]
    want: tuple[Any, ...]
    play: Play
    listens: Callable[[Stage, str], None] = _nothing
    check: Callable[[list[Taken]], str] = _all_right
    timeout: float = 10.0  # seconds, of each request of the client
    keys: str = ""  # "known", "unknown": over TCP with such keys


class AnyError:
    """The result is an error, whatever the client calls it."""

    def __repr__(self) -> str:
        return "an error"


FAILS = AnyError()
_CAMERA = pb.Status(config_name="camera", mode="default", sequence=7)


def _status(stage: Stage, taken: Taken) -> None:
    stage.reply(taken, status=_CAMERA)


def _with_unknown_fields(stage: Stage, taken: Taken) -> None:
    """Fields 3000 (text) and 3001 (number) are of a manager that is newer than the client."""
    newer = b"\xc2\xbb\x01\x03new" + b"\xc8\xbb\x01\x05"
    status = _CAMERA.SerializeToString() + newer
    body = b"\x08\x01" + b"\x52" + bytes([len(status)]) + status + newer  # ok, and status as field 10
    stage.reply_raw(taken, body)


def _refuse(code: str) -> Play:
    return lambda stage, taken: stage.reply(taken, error=pb.Error(code=code, message="as the case has it"))


def _registers(**values: int) -> Play:
    def play(stage: Stage, taken: Taken) -> None:
        entries = [pb.RegValue(name=name, value=value) for name, value in values.items()]
        stage.reply(taken, registers=pb.RegValues(values=entries, config_name="camera", mode="default", generation=41))

    return play


def _writes(*want: rq.RegWrite, lease: str = "") -> Callable[[list[Taken]], str]:
    def check(taken: list[Taken]) -> str:
        asked = [t.request for t in taken if isinstance(t.request, rq.WriteReg)]
        if [w for r in asked for w in r.writes] != list(want):
            return f"it should have written {want}, and wrote {[r.writes for r in asked]}"
        return "" if all(r.lease == lease for r in asked) else f"its writes should carry the lease {lease!r}"

    return check


class _OutOfOrder:
    """The first request is answered after the second."""

    def __init__(self) -> None:
        self._first: Taken | None = None

    def __call__(self, stage: Stage, taken: Taken) -> None:
        if self._first is None:
            self._first = taken
            return
        for one in (taken, self._first):
            name = one.request.names[0] if isinstance(one.request, rq.ReadReg) else ""
            _registers(**{name: {"first": 1, "second": 2}.get(name, 0)})(stage, one)


class _Late:
    """The first request is answered only when the second has come, just before that."""

    def __init__(self) -> None:
        self._first: Taken | None = None

    def __call__(self, stage: Stage, taken: Taken) -> None:
        if self._first is None:
            self._first = taken
            return
        _registers(focus=1)(stage, self._first)
        _registers(focus=2)(stage, taken)


def _stream_asked(stage: Stage, taken: Taken) -> None:
    """What a client may ask before it subscribes, or for a single frame."""
    if isinstance(taken.request, rq.ReadData):
        stage.reply(taken, _PIXELS, frame=_frame("camera", 5, shape=[2, 3], dtype="uint16", length=12))
    elif taken.topic == "cm_data_config":
        stage.reply(taken, stream=pb.Stream(state=pb.StreamState(name="camera", direction="s2mm", open=True)))
    elif taken.topic == "cm_read_config":
        stage.reply(taken, config=pb.Config(name="camera", mode="default", names=["camera"]))
    else:
        _status(stage, taken)


_PIXELS = struct.pack("<6H", 1, 2, 3, 256, 257, 65535)


def _frame(stream: str, sequence: int, generation: int = 0, **more: Any) -> pb.Frame:
    base = {"shape": [4], "dtype": "uint8", "length": 4, "config_name": "camera", "mode": "default", **more}
    return pb.Frame(stream=stream, sequence=sequence, timestamp_ns=10**9 * sequence, generation=generation, **base)


def _frames(*numbers: tuple[str, int, int]) -> Callable[[Stage, str], None]:
    """Published to who subscribes: stream, sequence, generation."""

    def listens(stage: Stage, topic: str) -> None:
        for stream, sequence, generation in numbers if topic.startswith("cm_stream/cam") else ():
            stage.publish(f"cm_stream/{stream}", _frame(stream, sequence, generation), bytes([sequence] * 4))

    return listens


def _statuses(stage: Stage, topic: str) -> None:
    if "cm_status".startswith(topic) or topic == "cm_status":
        for number, mode in enumerate(("default", "default", "edge"), 7):
            busy = number == 8
            progress = pb.Progress(change=1, target_mode="edge", fraction=0.5) if busy else None
            status = pb.Status(config_name="camera", mode=mode, sequence=number, fpga_busy=busy, progress=progress)
            stage.publish("cm_status", status)


def _irqs(stage: Stage, topic: str) -> None:
    """Behind a status, for clients that wait for one until they listen; and without one, for those that do not."""
    if topic == "cm_status":
        stage.publish("cm_status", _CAMERA)
    if topic in ("cm_irq", "cm_status"):
        for name, count in (("frame_done", 1), ("other", 9), ("frame_done", 2), ("frame_done", 4)):
            stage.publish("cm_irq", pb.Irq(name=name, count=count, timestamp_ns=10**15 + count))


def _irq_asked(stage: Stage, taken: Taken) -> None:
    if taken.topic == "cm_irq":
        stage.reply(taken, irq=pb.Irq(name="frame_done", count=0, timestamp_ns=10))
    else:
        _stream_asked(stage, taken)


def _leases(stage: Stage, taken: Taken) -> None:
    if isinstance(taken.request, rq.TakeLease):
        stage.reply(taken, lease=pb.Lease(id="0123abcd", scope=taken.request.scope, seconds=30))
    elif isinstance(taken.request, (rq.RenewLease, rq.ReleaseLease)):
        stage.reply(taken, lease=pb.Lease(id=taken.request.id))
    else:
        _registers(focus=3)(stage, taken)


def _frame_sent(taken: list[Taken]) -> str:
    sent = [t for t in taken if isinstance(t.request, rq.WriteData)]
    if [bytes(t.payload[0]) for t in sent] != [b"\x01\x02\x03\xff"]:
        return "the bytes 1, 2, 3, 255 should have come as one payload frame behind the message"
    return ""


def _mode_asked(taken: list[Taken]) -> str:
    asked = [t.request for t in taken if isinstance(t.request, rq.ChangeMode)]
    return "" if [r.mode or r.name_or_mode for r in asked] == ["edge"] else "one request should ask for the mode edge"


def _change(stage: Stage, taken: Taken) -> None:
    if isinstance(taken.request, rq.ChangeMode):
        stage.reply(taken, change=pb.Change(number=3, done=True, seconds=0.25))
    else:
        _status(stage, taken)


def _read(name: str) -> Answer:
    return {"do": "read", "names": [name]}


def _value(**values: int) -> Answer:
    return {"values": values}


def cases() -> Iterator[Case]:
    """All of them, made anew: some have a state. What a client may ask beside its task is answered for the case."""
    for case in _cases():
        asks_status = any(action["do"] == "status" for action in case.do)
        yield case if asks_status else replace(case, play=_beside(case.play))


def _beside(play: Play) -> Play:
    def answered(stage: Stage, taken: Taken) -> None:
        (_status if isinstance(taken.request, rq.ReadStatus) else play)(stage, taken)

    return answered


def _cases() -> Iterator[Case]:
    status = {"config": "camera", "mode": "default", "busy": False}
    yield Case("status", "a request and its reply", ({"do": "status"},), (status,), _status)
    yield Case(
        "unknown-fields", "fields of a newer manager are ignored", ({"do": "status"},), (status,), _with_unknown_fields
    )
    yield Case(
        "refusal", "an error has its code", (_read("focus"),), ({"error": "region_busy"},), _refuse("region_busy")
    )
    yield Case(
        "unknown-code", "so has one never heard of", (_read("x"),), ({"error": "of_tomorrow"},), _refuse("of_tomorrow")
    )
    yield Case(
        "write", "registers in their order, and the generation of the write",
        ({"do": "write", "registers": {"focus": 2, "zoom": 1}},), ({**_value(focus=2, zoom=1), "generation": 41},),
        _registers(focus=2, zoom=1), check=_writes(rq.RegWrite("focus", 2), rq.RegWrite("zoom", 1)),
    )  # fmt: skip
    yield Case(
        "write-64-bits", "no digit is lost",
        ({"do": "write", "registers": {"wide": str(LARGE)}},), ({**_value(wide=LARGE), "generation": 41},),
        _registers(wide=LARGE), check=_writes(rq.RegWrite("wide", LARGE)),
    )  # fmt: skip
    yield Case(
        "write-masked", "a mask of 0 is a mask, and not none",
        ({"do": "write_masked", "name": "focus", "value": 3, "mask": 0},), ({**_value(focus=2), "generation": 41},),
        _registers(focus=2), check=_writes(rq.RegWrite("focus", 3, 0)),
    )  # fmt: skip
    yield Case(
        "write-named", "a field's value by its name",
        ({"do": "write", "registers": {"led.blink": "fast"}},), ({**_value(led=32), "generation": 41},),
        _registers(led=32), check=_writes(rq.RegWrite("led.blink", 0, named="fast")),
    )  # fmt: skip
    both = {"do": "together", "actions": [_read("first"), _read("second")]}
    yield Case(
        "out-of-order", "replies come as they are ready; each belongs to its request",
        (both,), ({"results": [_value(first=1), _value(second=2)]},), _OutOfOrder(),
    )  # fmt: skip
    yield Case(
        "late-reply", "a reply that comes after the time-out is not taken for that of another request",
        (_read("focus"), _read("focus")), (FAILS, _value(focus=2)), _Late(), timeout=0.5,
    )  # fmt: skip
    yield Case(
        "vanished", "who waits hears of a manager that goes away",
        (_read("focus"),), (FAILS,), lambda stage, _: stage.vanish(), timeout=60.0,
    )  # fmt: skip
    yield Case(
        "mode", "a change of mode and its seconds",
        ({"do": "mode", "mode": "edge"},), ({"seconds": 0.25},), _change, check=_mode_asked,
    )  # fmt: skip
    yield Case(
        "watch", "statuses as they are published; while a change runs the mode is that of before",
        ({"do": "statuses", "count": 3},), ({"modes": ["default", "default", "edge"]},), _status, _statuses,
    )  # fmt: skip
    data = [1, 2, 3, 256, 257, 65535]
    yield Case(
        "frame", "bytes beside a message, little-endian, in their shape",
        ({"do": "frame", "stream": "camera"},), ({"sequence": 5, "shape": [2, 3], "dtype": "uint16", "data": data},),
        _stream_asked,
    )  # fmt: skip
    yield Case(
        "frames", "a gap is a loss",
        ({"do": "frames", "stream": "camera", "count": 3},), ({"sequences": [4, 5, 8], "lost": 2},),
        _stream_asked, _frames(("camera", 4, 0), ("camera", 5, 0), ("camera", 8, 0)),
    )  # fmt: skip
    yield Case(
        "prefix", "frames of camera2 come to who subscribed to camera, and are not camera's",
        ({"do": "frames", "stream": "camera", "count": 2},), ({"sequences": [4, 5], "lost": 0},),
        _stream_asked, _frames(("camera2", 70, 0), ("camera", 4, 0), ("camera2", 71, 0), ("camera", 5, 0)),
    )  # fmt: skip
    yield Case(
        "after", "the first frame of a generation or a later one",
        ({"do": "after", "stream": "camera", "generation": 41},), ({"sequence": 6},),
        _stream_asked, _frames(("camera", 4, 0), ("camera", 5, 40), ("camera", 6, 42), ("camera", 7, 42)),
    )  # fmt: skip
    yield Case(
        "interrupts", "those of one name, each once",
        ({"do": "irqs", "name": "frame_done", "count": 3},), ({"counts": [1, 2, 4]},), _irq_asked, _irqs,
    )  # fmt: skip
    yield Case(
        "send", "payload behind the message",
        ({"do": "send", "stream": "to_pl", "data": [1, 2, 3, 255]},), ({},),
        lambda stage, taken: stage.reply(taken, frame=_frame("to_pl", 1)), check=_frame_sent,
    )  # fmt: skip
    yield Case(
        "lease", "its id goes along with what it lets pass",
        ({"do": "lease", "scope": "region:prr0"}, {"do": "write", "registers": {"focus": 3}}),
        ({"id": "0123abcd"}, {**_value(focus=3), "generation": 41}),
        _leases, check=_writes(rq.RegWrite("focus", 3), lease="0123abcd"),
    )  # fmt: skip
    yield Case("keys", "over TCP with CURVE", ({"do": "status"},), (status,), _status, keys="known")
    yield Case(
        "unknown-keys", "who is not let in is told, and does not wait for ever",
        ({"do": "status"},), (FAILS,), _status, keys="unknown", timeout=5.0,
    )  # fmt: skip

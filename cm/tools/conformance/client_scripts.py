# SPDX-License-Identifier: Apache-2.0
"""How the manager is played in each case, and what is then looked for in the client's requests."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from cm.tools.conformance.acting_manager import ActingManager, Play, Taken
from cm.wire import cm_pb2 as pb
from cm.wire.envelope import guest_named
from cm.wire.messages import requests as rq

CAMERA = pb.Status(config_name="camera", mode="default", sequence=7)


def status(manager: ActingManager, taken: Taken) -> None:
    manager.reply(taken, status=CAMERA)


def with_unknown_fields(manager: ActingManager, taken: Taken) -> None:
    """Fields 3000 (text) and 3001 (number) are of a manager that is newer than the client."""
    newer = b"\xc2\xbb\x01\x03new" + b"\xc8\xbb\x01\x05"
    status = CAMERA.SerializeToString() + newer
    body = b"\x08\x01" + b"\x52" + bytes([len(status)]) + status + newer  # ok, and status as field 10
    manager.reply_raw(taken, body)


def refuse(code: str) -> Play:
    return lambda manager, taken: manager.reply(taken, error=pb.Error(code=code, message="as the case has it"))


def registers(**values: int) -> Play:
    def play(manager: ActingManager, taken: Taken) -> None:
        entries = [pb.RegValue(name=name, value=value) for name, value in values.items()]
        manager.reply(
            taken, registers=pb.RegValues(values=entries, config_name="camera", mode="default", generation=41)
        )

    return play


def each(**values: int) -> Play:
    """Registers that are read one by one."""

    def play(manager: ActingManager, taken: Taken) -> None:
        name = taken.request.names[0] if isinstance(taken.request, rq.ReadReg) else ""
        registers(**{name: values.get(name, 0)})(manager, taken)

    return play


def asked_for(**guests: str) -> Callable[[list[Taken]], str]:
    """The guest in whose name each register was read; empty if the client asked in its own."""

    def check(taken: list[Taken]) -> str:
        reads = [t for t in taken if isinstance(t.request, rq.ReadReg)]
        named = {t.request.names[0]: guest_named(list(t.envelope)) for t in reads if isinstance(t.request, rq.ReadReg)}
        return "" if named == guests else f"its reads should be in the names of {guests}, and are in those of {named}"

    return check


def writes(*want: rq.RegWrite, lease: str = "") -> Callable[[list[Taken]], str]:
    def check(taken: list[Taken]) -> str:
        asked = [t.request for t in taken if isinstance(t.request, rq.WriteReg)]
        if [w for r in asked for w in r.writes] != list(want):
            return f"it should have written {want}, and wrote {[r.writes for r in asked]}"
        return "" if all(r.lease == lease for r in asked) else f"its writes should carry the lease {lease!r}"

    return check


class OutOfOrder:
    """The first request is answered after the second."""

    def __init__(self) -> None:
        self._first: Taken | None = None

    def __call__(self, manager: ActingManager, taken: Taken) -> None:
        if self._first is None:
            self._first = taken
            return
        for one in (taken, self._first):
            name = one.request.names[0] if isinstance(one.request, rq.ReadReg) else ""
            registers(**{name: {"first": 1, "second": 2}.get(name, 0)})(manager, one)


class Late:
    """The first request is answered only when the second has come, just before that."""

    def __init__(self) -> None:
        self._first: Taken | None = None

    def __call__(self, manager: ActingManager, taken: Taken) -> None:
        if self._first is None:
            self._first = taken
            return
        registers(focus=1)(manager, self._first)
        registers(focus=2)(manager, taken)


def stream_asked(manager: ActingManager, taken: Taken) -> None:
    """Answers what a client may request before it subscribes, or for a single frame."""
    if isinstance(taken.request, rq.ReadData):
        manager.reply(taken, PIXELS, frame=frame("camera", 5, shape=[2, 3], dtype="uint16", length=12))
    elif taken.topic == "cm_data_config":
        manager.reply(taken, stream=pb.StreamState(name="camera", direction="s2mm", open=True))
    elif taken.topic == "cm_read_config":
        manager.reply(taken, config=pb.Config(name="camera", mode="default", names=["camera"]))
    else:
        status(manager, taken)


PIXELS = struct.pack("<6H", 1, 2, 3, 256, 257, 65535)


def frame(stream: str, sequence: int, generation: int = 0, **more: Any) -> pb.Frame:
    base = {"shape": [4], "dtype": "uint8", "length": 4, "config_name": "camera", "mode": "default", **more}
    return pb.Frame(stream=stream, sequence=sequence, timestamp_ns=10**9 * sequence, generation=generation, **base)


def frames(*numbers: tuple[str, int, int]) -> Callable[[ActingManager, str], None]:
    """Published to subscribers: stream, sequence, generation."""

    def listens(manager: ActingManager, topic: str) -> None:
        for stream, sequence, generation in numbers if topic.startswith("cm_stream/cam") else ():
            manager.publish(f"cm_stream/{stream}", frame(stream, sequence, generation), bytes([sequence] * 4))

    return listens


def statuses(manager: ActingManager, topic: str) -> None:
    if "cm_status".startswith(topic) or topic == "cm_status":
        for number, mode in enumerate(("default", "default", "edge"), 7):
            busy = number == 8
            progress = pb.Progress(change=1, target_mode="edge", fraction=0.5) if busy else None
            status = pb.Status(config_name="camera", mode=mode, sequence=number, fpga_busy=busy, progress=progress)
            manager.publish("cm_status", status)


def irqs(manager: ActingManager, topic: str) -> None:
    """After a status, for clients that wait for one before they listen; and without one, for those that do not."""
    if topic == "cm_status":
        manager.publish("cm_status", CAMERA)
    if topic in ("cm_irq", "cm_status"):
        for name, count in (("frame_done", 1), ("other", 9), ("frame_done", 2), ("frame_done", 4)):
            manager.publish("cm_irq", pb.Irq(name=name, count=count, timestamp_ns=10**15 + count))


def irq_asked(manager: ActingManager, taken: Taken) -> None:
    if taken.topic == "cm_irq":
        manager.reply(taken, irq=pb.Irq(name="frame_done", count=0, timestamp_ns=10))
    else:
        stream_asked(manager, taken)


def leases(manager: ActingManager, taken: Taken) -> None:
    if isinstance(taken.request, rq.TakeLease):
        manager.reply(taken, lease=pb.Lease(id="0123abcd", scope=taken.request.scope, seconds=30))
    elif isinstance(taken.request, (rq.RenewLease, rq.ReleaseLease)):
        manager.reply(taken, lease=pb.Lease(id=taken.request.id))
    else:
        registers(focus=3)(manager, taken)


def frame_sent(taken: list[Taken]) -> str:
    sent = [t for t in taken if isinstance(t.request, rq.WriteData)]
    if [bytes(t.payload[0]) for t in sent] != [b"\x01\x02\x03\xff"]:
        return "the bytes 1, 2, 3, 255 should have come as one payload frame behind the message"
    return ""


def mode_asked(taken: list[Taken]) -> str:
    asked = [t.request for t in taken if isinstance(t.request, rq.ChangeMode)]
    return "" if [r.mode or r.name_or_mode for r in asked] == ["edge"] else "one request should ask for the mode edge"


def change(manager: ActingManager, taken: Taken) -> None:
    if isinstance(taken.request, rq.ChangeMode):
        manager.reply(taken, change=pb.Change(number=3, done=True, seconds=0.25))
    else:
        status(manager, taken)

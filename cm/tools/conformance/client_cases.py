# SPDX-License-Identifier: Apache-2.0
"""The cases that a client is tested with: each asks it for something, plays the manager, and knows the right answer."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from cm.tools.conformance import client_scripts as scripts
from cm.tools.conformance.acting_manager import ActingManager, Play, Taken
from cm.wire.messages import requests as rq

Answer = Mapping[str, Any]
LARGE = (1 << 64) - 1


def _nothing(_: ActingManager, __: str) -> None:
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
    listens: Callable[[ActingManager, str], None] = _nothing
    check: Callable[[list[Taken]], str] = _all_right
    timeout: float = 30.0  # seconds, of each request of the client; a loaded machine needs that long
    keys: str = ""  # "known", "unknown": over TCP with such keys


class AnyError:
    """The result is an error, whatever the client calls it."""

    def __repr__(self) -> str:
        return "an error"


FAILS = AnyError()


def _read(name: str) -> Answer:
    return {"do": "read", "names": [name]}


def _value(**values: int) -> Answer:
    return {"values": values}


def cases() -> Iterator[Case]:
    """All cases, made anew because some have a state.

    Requests of a client beside its task are answered without the case.
    """
    for case in _cases():
        asks_status = any(action["do"] == "status" for action in case.do)
        yield case if asks_status else replace(case, play=_beside(case.play))


def _beside(play: Play) -> Play:
    def answered(manager: ActingManager, taken: Taken) -> None:
        (scripts.status if isinstance(taken.request, rq.ReadStatus) else play)(manager, taken)

    return answered


def _cases() -> Iterator[Case]:
    status = {"config": "camera", "mode": "default", "busy": False}
    yield Case("status", "a request and its reply", ({"do": "status"},), (status,), scripts.status)
    yield Case(
        "unknown-fields",
        "fields of a newer manager are ignored",
        ({"do": "status"},),
        (status,),
        scripts.with_unknown_fields,
    )
    yield Case(
        "refusal",
        "an error has its code",
        (_read("focus"),),
        ({"error": "region_busy"},),
        scripts.refuse("region_busy"),
    )
    yield Case(
        "unknown-code",
        "and so does an unknown one",
        (_read("x"),),
        ({"error": "of_tomorrow"},),
        scripts.refuse("of_tomorrow"),
    )
    yield Case(
        "write", "registers in their order, and the generation of the write",
        ({"do": "write", "registers": {"zoom": 1, "focus": 2}},), ({**_value(zoom=1, focus=2), "generation": 41},),
        scripts.registers(zoom=1, focus=2), check=scripts.writes(rq.RegWrite("zoom", 1), rq.RegWrite("focus", 2)),
    )  # fmt: skip
    yield Case(
        "write-64-bits", "no digit is lost",
        ({"do": "write", "registers": {"wide": str(LARGE)}},), ({**_value(wide=LARGE), "generation": 41},),
        scripts.registers(wide=LARGE), check=scripts.writes(rq.RegWrite("wide", LARGE)),
    )  # fmt: skip
    yield Case(
        "write-masked", "a mask of 0 is a mask, and not none",
        ({"do": "write_masked", "name": "focus", "value": 3, "mask": 0},), ({**_value(focus=2), "generation": 41},),
        scripts.registers(focus=2), check=scripts.writes(rq.RegWrite("focus", 3, mask=0)),
    )  # fmt: skip
    yield Case(
        "write-named", "a field's value by its name",
        ({"do": "write", "registers": {"led.blink": "fast"}},), ({**_value(led=32), "generation": 41},),
        scripts.registers(led=32), check=scripts.writes(rq.RegWrite("led.blink", 0, named="fast")),
    )  # fmt: skip
    both = {"do": "together", "actions": [_read("first"), _read("second")]}
    yield Case(
        "out-of-order", "replies come as they are ready; each belongs to its request",
        (both,), ({"results": [_value(first=1), _value(second=2)]},), scripts.OutOfOrder(),
    )  # fmt: skip
    yield Case(
        "late-reply", "a reply that comes after the time-out is not taken for that of another request",
        (_read("focus"), _read("focus")), (FAILS, _value(focus=2)), scripts.Late(), timeout=5.0,
    )  # fmt: skip
    yield Case(
        "vanished", "waiting requests end when the manager goes away",
        (_read("focus"),), (FAILS,), lambda manager, _: manager.vanish(), timeout=60.0,
    )  # fmt: skip
    yield Case(
        "mode", "a change of mode and its seconds",
        ({"do": "mode", "mode": "edge"},), ({"seconds": 0.25},), scripts.change, check=scripts.mode_asked,
    )  # fmt: skip
    yield Case(
        "watch", "statuses as they are published; while a change runs the mode is that of before",
        ({"do": "statuses", "count": 3},), ({"modes": ["default", "default", "edge"]},),
        scripts.status, scripts.statuses,
    )  # fmt: skip
    data = [1, 2, 3, 256, 257, 65535]
    yield Case(
        "frame", "bytes beside a message, little-endian, in their shape",
        ({"do": "frame", "stream": "camera"},), ({"sequence": 5, "shape": [2, 3], "dtype": "uint16", "data": data},),
        scripts.stream_asked,
    )  # fmt: skip
    yield Case(
        "frames", "a gap is a loss",
        ({"do": "frames", "stream": "camera", "count": 3},), ({"sequences": [4, 5, 8], "lost": 2},),
        scripts.stream_asked, scripts.frames(("camera", 4, 0), ("camera", 5, 0), ("camera", 8, 0)),
    )  # fmt: skip
    yield Case(
        "prefix", "frames of camera2 reach subscribers of camera, and are not camera's",
        ({"do": "frames", "stream": "camera", "count": 2},), ({"sequences": [4, 5], "lost": 0},),
        scripts.stream_asked,
        scripts.frames(("camera2", 70, 0), ("camera", 4, 0), ("camera2", 71, 0), ("camera", 5, 0)),
    )  # fmt: skip
    yield Case(
        "after", "the first frame of a generation or a later one",
        ({"do": "after", "stream": "camera", "generation": 41},), ({"sequence": 6},),
        scripts.stream_asked, scripts.frames(("camera", 4, 0), ("camera", 5, 40), ("camera", 6, 42), ("camera", 7, 42)),
    )  # fmt: skip
    yield Case(
        "interrupts", "those of one name, each once",
        ({"do": "irqs", "name": "frame_done", "count": 3},), ({"counts": [1, 2, 4]},), scripts.irq_asked, scripts.irqs,
    )  # fmt: skip
    yield Case(
        "send", "payload behind the message",
        ({"do": "send", "stream": "to_pl", "data": [1, 2, 3, 255]},), ({},),
        lambda manager, taken: manager.reply(taken, frame=scripts.frame("to_pl", 1)), check=scripts.frame_sent,
    )  # fmt: skip
    yield Case(
        "lease", "its id goes along with what it lets pass",
        ({"do": "lease", "scope": "region:prr0"}, {"do": "write", "registers": {"focus": 3}}),
        ({"id": "0123abcd"}, {**_value(focus=3), "generation": 41}),
        scripts.leases, check=scripts.writes(rq.RegWrite("focus", 3), lease="0123abcd"),
    )  # fmt: skip
    yield Case(
        "guest", "a bridge asks in the name of its guest, and gets the reply",
        ({"do": "as_guest", "guest": "web:anna", "action": _read("focus")}, _read("zoom")),
        (_value(focus=4), _value(zoom=2)), scripts.each(focus=4, zoom=2),
        check=scripts.asked_for(focus="web:anna", zoom=""),
    )  # fmt: skip
    yield Case("keys", "over TCP with CURVE", ({"do": "status"},), (status,), scripts.status, keys="known")
    yield Case(
        "unknown-keys", "a client that is not admitted is told so, and does not wait for ever",
        ({"do": "status"},), (FAILS,), scripts.status, keys="unknown", timeout=5.0,
    )  # fmt: skip

# SPDX-License-Identifier: Apache-2.0
"""Time-outs as programs give them, and errors that go to other processes."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cm.client.core import calls
from cm.client.core.effects import DEFAULT, Ask, Deadline, seconds
from cm.client.core.events import InterruptEvents
from cm.client.core.remote_stream import reading_next
from cm.client.core.values import mode_name
from cm.client.errors import ConnectionLost, FrameReleased, NoAnswer, request_error
from cm.client.find_manager import Keys, load_keys, resolve
from cm.device.errors import device_error
from cm.errors import CmError, InvalidRequest, NotFound
from cm.networks.bridge.commands import BridgeEnds
from cm.networks.fleet.errors import FleetRefused
from cm.schema.problems import Problem, SchemaError
from cm.wire.encode import encode_request
from cm.wire.messages.requests import ReadData, RegWrite
from cm.wire.messages.status import ErrorInfo


@pytest.mark.parametrize(
    ("given", "meant"), [(0, 0), (2.5, 2.5), (None, None), (math.inf, None), (1e12, None), (-1, 0.0), (-math.inf, 0.0)]
)
def test_a_time_out_is_a_number_of_seconds_or_for_ever(given: Any, meant: float | None) -> None:
    assert seconds(given, 5.0) == meant
    assert seconds(DEFAULT, meant) == meant
    assert Deadline(given).limit == meant


@pytest.mark.parametrize("given", [math.nan, "5", [1]])
def test_what_is_no_time_is_no_time_out(given: Any) -> None:
    with pytest.raises(InvalidRequest, match="a number of seconds, or None"):
        seconds(given, 5.0)


def test_subscribing_waits_for_the_manager_whatever_the_time_out_for_events() -> None:
    waits = next(InterruptEvents(object(), 0.0, "frame_done").opening())  # type: ignore[arg-type]
    assert 4 < waits.timeout <= 5  # type: ignore[union-attr]


def test_a_frame_without_a_time_out_is_asked_for_again_and_again() -> None:
    flow = reading_next("camera", None, 2.0)
    first = next(flow)
    assert isinstance(first, Ask)
    assert isinstance(first.call.request, ReadData)
    assert first.timeout == first.call.request.timeout + 2.0  # type: ignore[operator]
    again = flow.throw(request_error(ErrorInfo("timeout", "no frame")))
    assert again.call.request == first.call.request  # type: ignore[union-attr]
    with pytest.raises(StopIteration):
        flow.send(object())


def test_a_frame_that_need_not_be_waited_for_is_not_waited_for_a_second() -> None:
    """A time-out of 0 would be the manager's own default."""
    flow = reading_next("camera", 0.0, None)
    asked: Any = next(flow)
    assert 0 < asked.call.request.timeout < 0.1
    with pytest.raises(CmError, match="no frame"):
        flow.throw(request_error(ErrorInfo("timeout", "no frame")))


ERRORS = [
    request_error(ErrorInfo("held_by", "held by the test")),
    request_error(ErrorInfo("timeout", "no frame")),
    request_error(ErrorInfo("forbidden", "observers only")),
    request_error(ErrorInfo("unknown_mode", "no mode egde")),
    request_error(ErrorInfo("icap", "a CRC")),
    NoAnswer("no answer"),
    ConnectionLost("it went away"),
    FrameReleased("given back"),
    device_error(16, "open", "/dev/cm_icap"),
    SchemaError([Problem(Path("a.yaml"), 1, 2, "config", "unknown_key", "no such key")]),
    FleetRefused({"b1": ErrorInfo("busy", "in use")}),
    BridgeEnds(),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
@pytest.mark.parametrize(
    "again", [lambda error: pickle.loads(pickle.dumps(error)), copy.copy, copy.deepcopy], ids=["pickle", "copy", "deep"]
)
def test_an_error_arrives_in_another_process_as_it_was(error: CmError, again: Any) -> None:
    """One that cannot be unpickled breaks a whole pool of processes."""
    error.args = error.args  # as `raise` leaves it
    arrived = again(error)
    assert type(arrived) is type(error)
    assert (str(arrived), repr(arrived), arrived.code) == (str(error), repr(error), error.code)
    assert {n: str(v) for n, v in vars(arrived).items()} == {n: str(v) for n, v in vars(error).items()}
    assert getattr(arrived, "errno", None) == getattr(error, "errno", None)
    assert getattr(arrived, "filename", None) == getattr(error, "filename", None)


def test_pairs_write_a_register_several_times() -> None:
    pairs: list[tuple[str, int | str]] = [("start", 1), ("focus", 2), ("start", 0)]
    request: Any = calls.write_registers(pairs).request
    assert request.writes == (RegWrite("start", 1), RegWrite("focus", 2), RegWrite("start", 0))


@pytest.mark.parametrize("value", [0, 7, (1 << 64) - 1, np.uint8(7), np.int64(7)])
def test_a_register_takes_an_integer(value: Any) -> None:
    request: Any = calls.write_registers({"focus": value}).request
    assert request.writes == (RegWrite("focus", int(value)),)
    assert type(request.writes[0].value) is int


def test_a_fields_value_may_be_named() -> None:
    request: Any = calls.write_registers({"control.mode": "fast"}).request
    assert request.writes == (RegWrite("control.mode", 0, named="fast"),)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (True, "an integer, not True: write 1"),
        (np.bool_(False), r"an integer, not .*False.*: write 0"),
        (1.0, r"an integer, not 1\.0 \(float\)"),
        ("", r"an integer, not '' \(str\)"),
        (None, r"an integer, not None \(NoneType\)"),
        (-1, r"an integer from 0 to 2\*\*64 - 1, not -1; in 32 bits that is 0xffffffff$"),
        (-(1 << 31) - 1, r"an integer from 0 to 2\*\*64 - 1, not -2147483649$"),
        (1 << 64, r"an integer from 0 to 2\*\*64 - 1, not 18446744073709551616$"),
    ],
)
def test_what_is_no_integer_of_a_register_is_refused(value: Any, words: str) -> None:
    with pytest.raises(InvalidRequest, match=f"^register 'focus' takes {words}"):
        calls.write_registers({"focus": value})


@pytest.mark.parametrize("mode", ["", None, 3, b"edge"])
def test_a_mode_is_named_by_a_word(mode: Any) -> None:
    assert mode_name("edge") == "edge"
    with pytest.raises(InvalidRequest, match=rf"a mode is named by a word, not {mode!r}; load\(config\) goes to its"):
        mode_name(mode)


@pytest.mark.parametrize("given", ["focus", 3, [("focus",)], [3]])
def test_what_is_no_writes_is_refused_in_a_sentence(given: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"\{name: value\}, or pairs"):
        calls.write_registers(given)


@pytest.mark.parametrize(
    "call",
    [
        calls.load(3, "", wait=True, queue=True, force=False, lease=""),  # type: ignore[arg-type]
        calls.read_registers((["focus"],)),  # type: ignore[arg-type]
        calls.describe(b"\xff"),  # type: ignore[arg-type]
        calls.interrupt("\ud800"),
        calls.read_memory("scratchpad", -4, 4),
    ],
)
def test_what_no_message_can_hold_is_refused_as_any_request(call: calls.Call[Any]) -> None:
    with pytest.raises(InvalidRequest):
        encode_request(call.request)


def test_a_folder_may_be_a_path(tmp_path: Path) -> None:
    (tmp_path / "req").touch()
    assert resolve(tmp_path, None) == resolve(str(tmp_path), None) == resolve(None, tmp_path)


def test_a_host_that_is_taken_for_a_folder_gets_a_hint() -> None:
    with pytest.raises(NotFound, match=r"a manager on another machine is tcp://kria\.local"):
        resolve("kria.local", None)


@pytest.mark.parametrize("endpoint", ["TCP://kria.local", "udp://kria.local:5560", "http://kria.local"])
def test_an_address_of_another_kind_is_no_folder(endpoint: str) -> None:
    with pytest.raises(InvalidRequest, match=r"tcp://host\[:port\]"):
        resolve(endpoint, None)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x7fELF\xff\xfe", "not a key file"),
        (b"server-public: a\npublic: b\nsecret: c\n", "40 characters"),
        (b"public: b\n", "no 'server-public' key"),
    ],
)
def test_a_file_that_is_no_key_file_is_named(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "my.key"
    path.write_bytes(content)
    with pytest.raises(InvalidRequest, match=rf"my\.key.*{says}"):
        load_keys(path)


def test_keys_are_checked_when_they_are_made() -> None:
    with pytest.raises(InvalidRequest, match="public"):
        Keys(b"0" * 40, b"0" * 39, b"0" * 40)

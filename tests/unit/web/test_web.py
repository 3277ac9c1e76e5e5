# SPDX-License-Identifier: Apache-2.0
"""The parts of `cm web`: admission, frames as pictures, changes inferred from statuses."""

from __future__ import annotations

import asyncio
import io
import json
import struct
from dataclasses import replace
from typing import Any

import aiohttp
import numpy as np
import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from cm.cli.web import _address
from cm.client.aio.board import Board
from cm.errors import InvalidRequest, NotFound
from cm.web import pictures, signals
from cm.web.changes import KEPT, ChangeLog
from cm.web.gate import Gate, is_loopback
from cm.web.history import KEPT as SECONDS
from cm.web.history import History
from cm.web.hub import Hub
from cm.web.server import Options, PageServer
from cm.web.topics import Topics
from cm.wire.messages.status import ErrorInfo, PrMode, Progress, SensorStatus, Status, StreamStatus

GATE = Gate.of("a token that is long", ["kria.local"])


# ---- admission --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "host", ["localhost:80", "127.0.0.1", "192.168.0.4:8470", "[::1]:1", "KRIA.local:8470", "kria.local.:1"]
)
def test_addresses_and_known_names_are_let_in(host: str) -> None:
    assert GATE.refuses_host(host) == ""


@pytest.mark.parametrize(
    "host",
    [
        "",
        "evil.example",
        "127.0.0.1.evil.example",
        "kria.local@evil.example",
        "localhost:x",
        "a/b",
        "2130706433",
        "::1",
    ],
)
def test_a_host_name_that_others_may_have_chosen_is_refused(host: str) -> None:
    assert GATE.refuses_host(host) != ""


def test_only_the_servers_own_page_may_connect_from_a_browser() -> None:
    assert GATE.refuses_origin("http://127.0.0.1:8470", "127.0.0.1:8470") == ""
    assert GATE.refuses_origin(None, "127.0.0.1:8470") == ""
    for origin in ("http://127.0.0.1:8471", "null", "", "http://evil.example", "file://"):
        assert GATE.refuses_origin(origin, "127.0.0.1:8470") != ""


@given(st.none() | st.integers() | st.text() | st.lists(st.text()))
def test_only_the_exact_token_is_accepted(given_token: object) -> None:
    assert not GATE.knows(given_token)
    assert GATE.knows("a token that is long")


def test_a_token_that_can_be_guessed_is_refused_and_fresh_ones_differ() -> None:
    with pytest.raises(InvalidRequest, match="16 at least"):
        Gate.of("short", [])
    assert Gate.of("", []).token != Gate.of("", []).token


def test_a_page_that_has_gone_before_its_socket_opens_is_no_error(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Whoever opens many connections could have written tracebacks into the log."""

    async def gone(*_: object) -> None:
        raise ConnectionResetError("Connection lost")

    def nobody() -> Board:
        raise NotFound("no configuration manager")

    async def scenario() -> None:
        address: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        serving = asyncio.create_task(PageServer(Options(nobody, GATE, port=0)).serve(address.set_result))
        origin = (await address).partition("/#")[0]
        async with aiohttp.ClientSession() as client:
            with pytest.raises(aiohttp.WSServerHandshakeError):
                await client.ws_connect(f"{origin}/ws")
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)

    monkeypatch.setattr(web.WebSocketResponse, "prepare", gone)
    asyncio.run(scenario())
    assert caplog.records == []


def test_loopback_is_known_by_its_address() -> None:
    assert [is_loopback(h) for h in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "kria.local")] == [True] * 3 + [
        False
    ] * 2


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", ("127.0.0.1", 8470)),
        ("0", ("127.0.0.1", 0)),
        ("0.0.0.0", ("0.0.0.0", 8470)),
        ("kria:80", ("kria", 80)),
        ("[::1]:80", ("::1", 80)),
        ("[::1]", ("::1", 8470)),
    ],
)
def test_where_to_listen_may_be_a_host_a_port_or_both(text: str, where: tuple[str, int]) -> None:
    assert _address(text) == where


# ---- pictures ---------------------------------------------------------------------------


def opened(message: bytes) -> tuple[dict[str, Any], bytes]:
    (length,) = struct.unpack_from("<H", message)
    return json.loads(message[2 : 2 + length]), message[2 + length :]


@pytest.mark.parametrize(("shape", "kind"), [((4, 6), "grey"), ((4, 6, 3), "rgb"), ((4, 6, 1), "grey")])
def test_a_picture_of_bytes_is_sent_as_it_is(shape: tuple[int, ...], kind: str) -> None:
    frame = np.arange(np.prod(shape), dtype=np.uint8).reshape(shape)
    header, payload = opened(pictures.message("camera", frame, {"sequence": 7}, "", True))
    assert (header["kind"], header["width"], header["height"], header["sequence"]) == (kind, 6, 4, 7)
    assert payload == frame.tobytes()


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3), (48, 64, 4)])
def test_elsewhere_it_is_a_jpeg_that_others_can_read(shape: tuple[int, ...]) -> None:
    frame = np.full(shape, 200, np.uint8)
    header, payload = opened(pictures.message("camera", frame, {}, "", False))
    with Image.open(io.BytesIO(payload)) as image:
        assert (header["kind"], image.format, image.size) == ("jpeg", "JPEG", (64, 48))
        assert abs(int(np.asarray(image).mean()) - 200) < 3


def test_a_large_frame_is_shown_with_every_nth_pixel() -> None:
    frame = np.zeros((2160, 3840), np.uint8)
    frame[::3, ::3] = 9
    header, payload = opened(pictures.message("camera", frame, {}, "", True))
    assert (header["step"], header["width"], header["height"], set(payload)) == (3, 1280, 720, {9})


def test_numbers_are_spread_over_the_visible_range() -> None:
    header, payload = opened(
        pictures.message("depth", np.array([[-2.0, 0.0], [np.nan, 6.0]], np.float32), {}, "", True)
    )
    assert (header["range"], list(payload)) == ([-2.0, 6.0], [0, 64, 0, 255])


def test_a_signal_keeps_its_peaks_however_long_it_is() -> None:
    signal = np.zeros(100_000, np.int16)
    signal[70_001], signal[20_003] = 30_000, -20_000
    header, payload = opened(pictures.message("adc", signal, {}, "", True))
    low, high = np.frombuffer(payload, "<f4").reshape(2, -1)
    assert (header["kind"], header["columns"], header["range"]) == ("signal", signals.COLUMNS, [-20_000, 30_000])
    assert (low.min(), high.max()) == (-20_000, 30_000)


DTYPES = st.sampled_from(["u1", "i2", "u4", "i8", "f4", "f8", "c8", "?"])


@given(
    DTYPES.flatmap(lambda kind: arrays.arrays(kind, arrays.array_shapes(min_dims=0, max_dims=5, max_side=7))),
    st.sampled_from(["", "spectrum", "constellation"]),
)
def test_every_frame_has_a_picture_that_is_as_large_as_it_says(frame: Any, view: str) -> None:
    for near in (True, False):
        header, payload = opened(pictures.message("any", frame, {}, view, near))
        sizes = {"grey": 1, "rgb": 3}
        if header["kind"] == "signal":
            planes = {"": 2 * len(header.get("lines", ())), "spectrum": 1, "constellation": 2}[header["view"]]
            assert len(payload) == 4 * planes * header["columns"]
            assert np.isfinite([*header["range"], *np.frombuffer(payload, "<f4")]).all(), "what JSON and a canvas take"
        elif header["kind"] in sizes:
            assert len(payload) == header["width"] * header["height"] * sizes[header["kind"]]
        else:
            assert header["kind"] == "jpeg"


def test_a_spectrum_is_in_decibels_of_a_tone_of_full_scale() -> None:
    turns = 2 * np.pi * np.arange(4096)
    tone = (16384 * np.cos(turns / 16)).astype(np.int16)  # half of full scale
    header, payload = opened(pictures.message("adc", tone, {}, "spectrum", True))
    line = np.frombuffer(payload, "<f4")
    assert (header["low"], int(line.argmax())) == (0, header["columns"] // 16 * 2)
    assert abs(line.max() + 6.02) < 0.05
    pairs = np.stack([tone, (16384 * np.sin(-turns / 16)).astype(np.int16)], axis=1)  # at -1/16 of the sample rate
    header, payload = opened(pictures.message("adc", pairs, {}, "spectrum", True))
    line = np.frombuffer(payload, "<f4")
    assert header["low"] + int(line.argmax()) / header["columns"] == -1 / 16
    assert abs(line.max() + 6.02) < 0.05


def test_an_empty_frame_is_reported_as_empty() -> None:
    assert opened(pictures.message("x", np.zeros((0, 5), np.uint8), {}, "", True))[0]["kind"] == "empty"


# ---- changes ----------------------------------------------------------------------------


def running(step: str, number: int = 2, subject: str = "") -> Status:
    return Status("camera", "", True, PrMode.PARTIAL, Progress(number, "camera", "edge", step, subject), last_change=1)


def test_a_change_is_its_steps_and_how_it_ended() -> None:
    log = ChangeLog()
    log.take(Status("camera", "default", last_change=1))
    for status in (running("validate"), running("load", subject="prr0"), running("load", subject="prr0")):
        assert log.take(status)
    assert log.take(Status("camera", "edge", last_change=2, last_change_seconds=0.5))
    (change,) = log.changes
    assert [(s["step"], s["subject"]) for s in change["steps"]] == [("validate", ""), ("load", "prr0")]
    assert all(s["seconds"] >= 0 for s in change["steps"])
    assert (change["number"], change["mode"], change["state"], change["seconds"]) == (2, "edge", "done", 0.5)


def test_the_end_of_a_change_that_ran_before_this_began_to_look_is_told() -> None:
    log = ChangeLog()
    log.take(running("load"))
    assert log.take(Status("camera", "edge", last_change=2, last_change_seconds=0.5))
    assert log.changes[0]["state"] == "done"


def test_a_change_that_failed_says_why() -> None:
    log = ChangeLog()
    log.take(Status("camera", "default", last_change=1))
    log.take(running("load"))
    error = ErrorInfo("load_failed", "the port said no")
    log.take(Status("camera", "default", pr_mode=PrMode.ERROR, last_error=error, last_change=2))
    assert (log.changes[0]["state"], log.changes[0]["error"]["code"]) == ("failed", "load_failed")


def test_a_change_that_was_not_seen_running_is_listed_without_steps() -> None:
    log = ChangeLog()
    log.take(Status("camera", "default", last_change=1))
    log.take(Status("camera", "edge", last_change=2, last_change_seconds=0.1))
    assert [(c["number"], c["state"], c["steps"]) for c in log.changes] == [(2, "done", [])]


def test_a_status_that_a_later_one_has_overtaken_begins_no_change_again() -> None:
    hub = Hub(lambda: None, control=False)  # type: ignore[arg-type,return-value]
    before, after = (Status("camera", "default", sequence=n, last_change=m, started_ns=1) for n, m in ((6, 3), (8, 4)))
    begun = replace(running("load", 4), sequence=7, last_change=3, started_ns=1)
    for status in (before, begun, after, begun, after):
        hub.take(status)
    assert hub.status == after
    assert [change["number"] for change in json.loads(hub.topics.message(["changes"]))["changes"]] == [4]


def test_a_manager_that_died_in_a_change_has_lost_it() -> None:
    log = ChangeLog()
    log.take(running("load"))
    log.forget()
    assert not log.take(Status("camera", "default", last_change=1))
    assert [c["state"] for c in log.changes] == ["lost"]


def test_the_history_does_not_grow() -> None:
    log, history = ChangeLog(), History()
    log.take(Status(last_change=0))
    for number in range(1, 3 * KEPT):
        log.take(Status(last_change=number))
    for second in range(2 * SECONDS):
        history.add(float(second), Status(last_change=second))
    assert (len(log.changes), len(history.plain())) == (KEPT, SECONDS)


# ---- over time, and what is told ----------------------------------------------------------


def test_a_point_has_rates_sensors_and_the_last_change() -> None:
    sensors = (SensorStatus("xadc", "temp0", "temperature", 40.5),)
    stream = StreamStatus("camera", "c", "s2mm", open=True, rate=30.0, latency_us=50.0)
    history = History()
    closed = StreamStatus("other", "o", "s2mm")
    assert history.add(1.0, Status(streams=(closed,), last_change=4, last_change_seconds=9.0))["values"] == {}
    point = history.add(2.0, Status(streams=(stream,), sensors=sensors, last_change=5, last_change_seconds=0.25))
    wanted = {"rate:camera": 30.0, "latency:camera": 50.0, "temperature:xadc temp0": 40.5, "change": 250.0}
    assert point == {"at": 2.0, "values": wanted}


def test_a_topic_is_announced_when_it_changes_and_sent_only_in_its_newest_form() -> None:
    topics, told = Topics(), list[str]()
    topics.listen(told.append)
    for value in ({"a": 1}, {"a": 1}, {"a": 2}):
        topics.tell("x", value)
    topics.ignore(told.append)
    topics.tell("y", None)
    assert told == ["x", "x"]
    assert json.loads(topics.message(["x", "y", "none"])) == {"x": {"a": 2}, "y": None}

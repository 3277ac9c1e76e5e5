# SPDX-License-Identifier: Apache-2.0
"""When streams run, without sockets or devices: who uses them, and what clients have set."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.errors import InvalidRequest
from cm.manager.errors import NothingLoaded, UnknownStream
from cm.schema import loads
from cm.schema.model import Config, Direction
from cm.server.streams.lifecycle import (
    StreamLifecycle,
    StreamStopped,
)
from cm.server.streams.machine import OPEN_PHASES, TRANSITIONS, StreamEvent, StreamPhase
from cm.wire.messages.requests import ConfigureStream

TEXT = """
config:
  name: {name}
  modules: [one, two]
  streams:
    camera: {{direction: s2mm, shape: [4, 4]}}
    out: {{direction: mm2s, shape: [4]}}
  modes:
    one: {{modules: [one]}}
    two: {{modules: [two], streams: {{camera: {{shape: [8, 8]}}}}}}
"""


def config(name: str = "video") -> Config:
    return loads(TEXT.format(name=name))


@pytest.fixture
def lifecycle() -> StreamLifecycle:
    made = StreamLifecycle()
    made.enter(config(), "one")
    return made


def due(lifecycle: StreamLifecycle, **used: bool) -> dict[str, StreamEvent]:
    return {stream.name: event for event, stream in lifecycle.due(lambda s: used.get(s.name, False))}


def set_to(lifecycle: StreamLifecycle, name: str, **settings: object) -> None:
    stream = lifecycle.streams[name]
    lifecycle.override(stream, stream, ConfigureStream(name, **settings))  # type: ignore[arg-type]


@given(st.lists(st.sampled_from(StreamEvent), max_size=30))
def test_closed_streams_alone_are_opened_and_open_ones_closed_whatever_came_before(
    events: list[StreamEvent],
) -> None:
    lifecycle = StreamLifecycle()
    lifecycle.enter(config(), "one")
    camera = lifecycle.machine("camera")
    for event in events:
        camera.rest_until = math.inf
        if (camera.phase, event) in TRANSITIONS:
            camera.after(event)
        opens, closes = camera.phase is StreamPhase.CLOSED, camera.phase in OPEN_PHASES
        assert due(lifecycle, camera=True) == ({"camera": StreamEvent.OPEN} if opens else {})
        assert due(lifecycle) == ({"camera": StreamEvent.CLOSE} if closes else {})
        assert lifecycle.may_run("camera") != lifecycle.is_held("camera")


def test_a_stream_runs_while_it_is_used(lifecycle: StreamLifecycle) -> None:
    assert due(lifecycle, camera=True) == {"camera": StreamEvent.OPEN}
    lifecycle.machine("camera").after(StreamEvent.OPEN)
    assert due(lifecycle, camera=True) == {}
    assert due(lifecycle) == {"camera": StreamEvent.CLOSE}


def test_a_clients_setting_takes_precedence_over_use_by_readers(lifecycle: StreamLifecycle) -> None:
    set_to(lifecycle, "camera", enable=True)
    assert due(lifecycle) == {"camera": StreamEvent.OPEN}
    set_to(lifecycle, "camera", enable=False)
    assert due(lifecycle, camera=True) == {}
    assert not lifecycle.may_run("camera")
    with pytest.raises(StreamStopped, match="enable"):
        lifecycle.check_may_run("camera")
    set_to(lifecycle, "camera", automatic=True)
    assert due(lifecycle, camera=True) == {"camera": StreamEvent.OPEN}


def test_a_stream_that_is_the_same_in_the_next_mode_runs_on(lifecycle: StreamLifecycle) -> None:
    for name in ("camera", "out"):
        lifecycle.machine(name).after(StreamEvent.OPEN)
    assert lifecycle.enter(config(), "two") == ["camera"], "its frames have another shape there"
    assert lifecycle.streams["camera"].shape == (8, 8)


def test_the_end_of_a_change_releases_what_it_held(lifecycle: StreamLifecycle) -> None:
    lifecycle.machine("camera").after(StreamEvent.HOLD)
    with pytest.raises(StreamStopped, match="region changes"):
        lifecycle.check_may_run("camera")
    lifecycle.enter(config(), "two")
    lifecycle.check_may_run("camera")


def test_settings_go_with_the_mode_and_what_runs_with_the_configuration(lifecycle: StreamLifecycle) -> None:
    stream = lifecycle.streams["out"]
    wanted = loads(TEXT.format(name="video").replace("shape: [4]", "shape: [9]")).streams["out"]
    lifecycle.override(stream, wanted, ConfigureStream("out", shape=(9,), enable=True))
    assert lifecycle.streams["out"].shape == (9,)
    lifecycle.enter(config(), "two")
    assert lifecycle.streams["out"].shape == (4,)
    assert lifecycle.set_to_run("out")
    lifecycle.enter(config("audio"), "one")
    assert not lifecycle.set_to_run("out")


def test_settings_last_as_long_as_the_schema_says_the_same_of_the_stream(lifecycle: StreamLifecycle) -> None:
    for length in (9, 16):  # each of the last request
        stream = lifecycle.streams["out"]
        wanted = replace(stream, shape=(length,))
        lifecycle.override(stream, wanted, ConfigureStream("out", shape=(length,)))
    lifecycle.enter(config(), "one")
    assert lifecycle.streams["out"].shape == (16,)
    other = loads(TEXT.format(name="video").replace("direction: mm2s, shape: [4]", "direction: mm2s, shape: [5]"))
    for mode in (other, config()):
        lifecycle.enter(mode, "one")
        assert lifecycle.streams["out"] == mode.streams["out"]


def test_a_setting_that_is_taken_back_leaves_those_of_others(lifecycle: StreamLifecycle) -> None:
    camera, out = lifecycle.streams["camera"], lifecycle.streams["out"]
    first = replace(out, shape=(9,))
    take_back = lifecycle.override(out, first, ConfigureStream("out", shape=(9,), enable=True))
    lifecycle.override(camera, replace(camera, shape=(2, 2)), ConfigureStream("camera", shape=(2, 2), enable=False))
    second = replace(out, shape=(16,))
    lifecycle.override(first, second, ConfigureStream("out", shape=(16,)))
    take_back()  # it has been changed again since
    assert (lifecycle.streams["out"], lifecycle.set_to_run("out")) == (second, True)
    lifecycle.override(second, first, ConfigureStream("out", automatic=True))()
    lifecycle.enter(config(), "one")
    assert (lifecycle.streams["out"].shape, lifecycle.set_to_run("out")) == ((16,), True)
    assert lifecycle.streams["camera"].shape == (2, 2)
    with pytest.raises(StreamStopped, match="'camera' was stopped; cm_data_config with enable lets it run"):
        lifecycle.check_may_run("camera")


def test_a_setting_that_is_taken_back_leaves_nothing(lifecycle: StreamLifecycle) -> None:
    before = dict(lifecycle.streams)
    stream = lifecycle.streams["out"]
    lifecycle.override(stream, stream, ConfigureStream("out", enable=True))()
    assert (dict(lifecycle.streams), lifecycle.set_to_run("out")) == (before, False)


def test_streams_are_found_by_name_or_as_the_only_one_of_their_direction(lifecycle: StreamLifecycle) -> None:
    assert lifecycle.named("", Direction.S2MM).name == "camera"
    assert lifecycle.named("out", Direction.MM2S).name == "out"
    with pytest.raises(InvalidRequest, match="stream 'out' is mm2s: it cannot be used the other way"):
        lifecycle.named("out", Direction.S2MM)
    with pytest.raises(UnknownStream, match=r"no stream 'camra' in mode 'one'.*did you mean 'camera'"):
        lifecycle.named("camra", None)
    with pytest.raises(UnknownStream, match="name a stream; s2mm streams of this mode are camera, out"):
        _two_inputs().named("", Direction.S2MM)
    with pytest.raises(UnknownStream, match="name a stream; mm2s streams of this mode are none"):
        _two_inputs().named("", Direction.MM2S)
    lifecycle.enter(config(), None)
    with pytest.raises(UnknownStream, match="no stream 'camra' while video is in no mode"):
        lifecycle.named("camra", None)
    with pytest.raises(NothingLoaded, match="nothing is loaded, so there are no streams"):
        StreamLifecycle().named("camera", None)


def _two_inputs() -> StreamLifecycle:
    lifecycle = StreamLifecycle()
    lifecycle.enter(loads(TEXT.format(name="video").replace("direction: mm2s", "direction: s2mm")), "one")
    return lifecycle


def test_a_stream_that_could_not_be_opened_is_due_after_a_while_or_in_another_mode(lifecycle: StreamLifecycle) -> None:
    camera = lifecycle.machine("camera")
    for until, event in ((math.inf, None), (0.0, StreamEvent.OPEN)):
        camera.after(StreamEvent.FAIL)
        camera.rest_until = until
        assert due(lifecycle, camera=True).get("camera") is event
        assert lifecycle.may_run("camera")
        lifecycle.enter(config(), "one")
        assert due(lifecycle, camera=True) == {"camera": StreamEvent.OPEN}

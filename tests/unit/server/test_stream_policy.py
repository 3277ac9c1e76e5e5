# SPDX-License-Identifier: Apache-2.0
"""When streams run, without sockets or devices: the table of phases, and the decisions between them."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.errors import InvalidRequest, Timeout
from cm.manager.errors import NothingLoaded, UnknownStream
from cm.schema import loads
from cm.schema.model import Config, Direction
from cm.server.streams.policy import (
    TRANSITIONS,
    IllegalTransition,
    StreamEvent,
    StreamPhase,
    StreamPolicy,
    StreamStopped,
    Users,
    decide,
)
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
USED, UNUSED = Users(subscriber=True), Users()


def config(name: str = "video") -> Config:
    return loads(TEXT.format(name=name))


@pytest.fixture
def policy() -> StreamPolicy:
    made = StreamPolicy()
    made.enter(config(), "one")
    return made


def due(policy: StreamPolicy, **users: Users) -> dict[str, StreamEvent]:
    return {stream.name: event for event, stream in policy.due(lambda s: users.get(s.name, UNUSED))}


def set_to(policy: StreamPolicy, name: str, **settings: object) -> None:
    stream = policy.streams[name]
    policy.override(stream, stream, ConfigureStream(name, **settings))  # type: ignore[arg-type]


@pytest.mark.parametrize(("phase", "event"), list(product(StreamPhase, StreamEvent)))
def test_an_illegal_transition_raises_and_changes_nothing(phase: StreamPhase, event: StreamEvent) -> None:
    policy = StreamPolicy()
    ways = {
        StreamPhase.CLOSED: [],
        StreamPhase.OPEN: [StreamEvent.OPEN],
        StreamPhase.HELD: [StreamEvent.HOLD],
        StreamPhase.STALLED: [StreamEvent.STALL],
        StreamPhase.HELD_STALLED: [StreamEvent.STALL, StreamEvent.HOLD],
    }
    for step in ways[phase]:
        policy.after("camera", step)
    assert policy.phase("camera") is phase
    if (phase, event) in TRANSITIONS:
        policy.after("camera", event)
        assert policy.phase("camera") is TRANSITIONS[phase, event]
    else:
        with pytest.raises(IllegalTransition, match="camera"):
            policy.after("camera", event)
        assert policy.phase("camera") is phase


@pytest.mark.parametrize("phase", list(StreamPhase))
@pytest.mark.parametrize("wanted", [True, False])
def test_only_a_closed_stream_is_opened_and_only_an_open_one_closed(phase: StreamPhase, wanted: bool) -> None:
    expected = {
        (StreamPhase.CLOSED, True): StreamEvent.OPEN,
        (StreamPhase.OPEN, False): StreamEvent.CLOSE,
    }
    event = decide(phase, wanted)
    assert event is expected.get((phase, wanted))
    assert event is None or (phase, event) in TRANSITIONS


@given(st.lists(st.sampled_from(StreamEvent), max_size=30))
def test_a_stream_that_is_held_or_stalled_is_never_opened_whatever_came_before(events: list[StreamEvent]) -> None:
    policy = StreamPolicy()
    policy.enter(config(), "one")
    for event in events:
        if (policy.phase("camera"), event) in TRANSITIONS:
            policy.after("camera", event)
        held, stalled = policy.is_held("camera"), "camera" in policy.stalled()
        assert (due(policy, camera=USED).get("camera") is StreamEvent.OPEN) == (
            policy.phase("camera") is StreamPhase.CLOSED
        )
        assert policy.may_run("camera") == (not held and not stalled)


@pytest.mark.parametrize("users", [Users(subscriber=True), Users(client=True), Users(transfer=True)])
def test_a_stream_runs_while_it_is_used(policy: StreamPolicy, users: Users) -> None:
    assert due(policy, camera=users) == {"camera": StreamEvent.OPEN}
    policy.after("camera", StreamEvent.OPEN)
    assert due(policy, camera=users) == {}
    assert due(policy) == {"camera": StreamEvent.CLOSE}


def test_a_clients_setting_takes_precedence_over_use_by_readers(policy: StreamPolicy) -> None:
    set_to(policy, "camera", enable=True)
    assert due(policy) == {"camera": StreamEvent.OPEN}
    set_to(policy, "camera", enable=False)
    assert due(policy, camera=USED) == {}
    assert not policy.may_run("camera")
    with pytest.raises(StreamStopped, match="enable"):
        policy.check_may_run("camera")
    set_to(policy, "camera", automatic=True)
    assert due(policy, camera=USED) == {"camera": StreamEvent.OPEN}


def test_a_stream_that_is_the_same_in_the_next_mode_runs_on(policy: StreamPolicy) -> None:
    for name in ("camera", "out"):
        policy.after(name, StreamEvent.OPEN)
    assert policy.enter(config(), "two") == ["camera"], "its frames have another shape there"
    assert policy.streams["camera"].shape == (8, 8)


def test_the_end_of_a_change_releases_what_it_held(policy: StreamPolicy) -> None:
    policy.after("camera", StreamEvent.HOLD)
    with pytest.raises(StreamStopped, match="region changes"):
        policy.check_may_run("camera")
    policy.enter(config(), "two")
    policy.check_may_run("camera")


def test_a_channel_that_answers_during_a_change_does_not_let_its_stream_run(policy: StreamPolicy) -> None:
    policy.after("camera", StreamEvent.STALL)
    with pytest.raises(Timeout, match="does not answer"):
        policy.check_may_run("camera")
    policy.after("camera", StreamEvent.HOLD)
    policy.after("camera", StreamEvent.ANSWER)
    assert not policy.may_run("camera")
    assert due(policy, camera=USED) == {}


def test_settings_go_with_the_mode_and_what_runs_with_the_configuration(policy: StreamPolicy) -> None:
    stream = policy.streams["out"]
    wanted = loads(TEXT.format(name="video").replace("shape: [4]", "shape: [9]")).streams["out"]
    policy.override(stream, wanted, ConfigureStream("out", shape=(9,), enable=True))
    assert policy.streams["out"].shape == (9,)
    policy.enter(config(), "two")
    assert policy.streams["out"].shape == (4,)
    assert policy.set_to_run("out")
    policy.enter(config("audio"), "one")
    assert not policy.set_to_run("out")


def test_a_setting_that_is_taken_back_leaves_nothing(policy: StreamPolicy) -> None:
    before = dict(policy.streams)
    stream = policy.streams["out"]
    policy.override(stream, stream, ConfigureStream("out", enable=True))()
    assert (dict(policy.streams), policy.set_to_run("out")) == (before, False)


def test_streams_are_found_by_name_or_as_the_only_one_of_their_direction(policy: StreamPolicy) -> None:
    assert policy.named("", Direction.S2MM).name == "camera"
    assert policy.named("out", Direction.MM2S).name == "out"
    with pytest.raises(InvalidRequest, match="mm2s"):
        policy.named("out", Direction.S2MM)
    with pytest.raises(UnknownStream, match="camera"):
        policy.named("camra", None)
    with pytest.raises(UnknownStream, match="name a stream"):
        _two_inputs().named("", Direction.S2MM)
    with pytest.raises(NothingLoaded):
        StreamPolicy().named("camera", None)


def _two_inputs() -> StreamPolicy:
    policy = StreamPolicy()
    policy.enter(loads(TEXT.format(name="video").replace("direction: mm2s", "direction: s2mm")), "one")
    return policy


def test_the_documentation_shows_the_table() -> None:
    page = Path(__file__).resolve().parents[3] / "docs" / "decisions" / "frames-as-descriptors.md"
    lines = ["stateDiagram-v2", "    [*] --> closed"]
    lines += [f"    {a.value} --> {b.value}: {event.value}" for (a, event), b in TRANSITIONS.items() if a is not b]
    assert "\n".join(lines) + "\n" in page.read_text(encoding="utf-8")

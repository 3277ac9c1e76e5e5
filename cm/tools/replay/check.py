# SPDX-License-Identifier: Apache-2.0
"""The requests of a record, made again: does the manager go through the same states?"""

from __future__ import annotations

import time
from typing import Any

from cm.client.core.calls import Call
from cm.errors import CmError, Timeout
from cm.frozen import dataclass, replace
from cm.recording.story import of_manager
from cm.tools.replay.board import Bench, Faults
from cm.tools.replay.script import Script, State, ended_states
from cm.wire.messages import requests as rq
from cm.wire.messages.status import ConfigInfo

_PATIENCE = 60.0  # seconds for a change to end


@dataclass(frozen=True, slots=True)
class Compared:
    """The states of a record, and those of a run; `differences` are sentences, none where they are alike."""

    recorded: tuple[State, ...]
    states: tuple[State, ...]
    differences: tuple[str, ...]


def check(made: Bench, script: Script) -> Compared:
    """Make the requests of a record again, each when the one before has its answer. Raises Timeout."""
    before = made.history().last_change
    faults, ended = Faults(made, script), dict[int, State]()
    done = before
    for _, request in script.requests:
        if isinstance(request, rq.ChangeMode) and request.no_wait:
            request = replace(request, no_wait=False)
        if isinstance(request, rq.CheckRegion) and request.repair:
            faults.upset(request.name)
        _ask(made, request)
        done = _settle(made, ended, before, done, faults)
    states = tuple(ended[number] for number in sorted(ended))
    return Compared(script.states, states, tuple(_differences(script.states, states)))


def _ask(made: Bench, request: Any) -> None:
    """Its refusal is an answer too: what was refused then is refused again, and the states show whether."""
    call: Call[Any] = Call(request, lambda reply: reply)
    try:
        made.board.ask(call, timeout=_PATIENCE)
    except CmError as error:
        if isinstance(error, Timeout):
            raise


def _settle(made: Bench, ended: dict[int, State], before: int, done: int, faults: Faults) -> int:
    """Wait until no change runs, and note the states of those that have ended; the number of the last."""
    end = time.monotonic() + _PATIENCE
    while (status := made.history()).fpga_busy:
        if time.monotonic() > end:
            raise Timeout(f"a change runs for more than {_PATIENCE:.0f} s")
    ended_states(ended, of_manager(status, ConfigInfo(), 0), before)
    for _ in range(done, status.last_change):
        faults.next()
    return status.last_change


def _differences(recorded: tuple[State, ...], states: tuple[State, ...]) -> list[str]:
    found = []
    for number, (then, now) in enumerate(zip(recorded, states, strict=False), 1):
        if then != now:
            found.append(f"state {number}: the record has {then}\n  and now it is {now}{_steps(then, now)}")
    if len(recorded) != len(states):
        found.append(f"the record has {len(recorded)} states, and now there are {len(states)}")
    return found


def _steps(then: State, now: State) -> str:
    if then.steps == now.steps:
        return ""
    at = next((at for at, (a, b) in enumerate(zip(then.steps, now.steps, strict=False)) if a != b), min(
        len(then.steps), len(now.steps)))  # fmt: skip
    a, b = (" ".join(steps[at]) if at < len(steps) else "the end" for steps in (then.steps, now.steps))
    return f"\n  they part at step {at + 1}: {a} then, {b} now"

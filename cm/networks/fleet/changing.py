# SPDX-License-Identifier: Apache-2.0
"""Carries out a change of many boards: sends the coordinator's requests, and gives it the answers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from cm.networks.fleet.change.asks import Ask
from cm.networks.fleet.change.coordinator import Coordinator, Outcome, Phase
from cm.wire.messages.fleet import FleetRecord, FleetStep
from cm.wire.messages.status import ErrorInfo

Asking = Callable[[Ask], Awaitable[FleetRecord | ErrorInfo]]  # an answer, or code "no_answer"
Progress = Callable[[str, str, FleetRecord | ErrorInfo], None]  # phase, board, its answer


def nothing(phase: str, board: str, answer: FleetRecord | ErrorInfo) -> None:
    """A receiver of progress that ignores it."""


@dataclass(frozen=True, slots=True)
class Leg:
    """One phase of a change: how long it took, and which board it waited for longest."""

    phase: str  # prepare, apply, seat, tell
    seconds: float
    slowest: str  # the board
    slowest_seconds: float


@dataclass
class Course:
    """A change that has ended: its outcome, and the critical path."""

    outcome: Outcome
    legs: list[Leg] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Of all phases."""
        return sum(leg.seconds for leg in self.legs)


async def carried_out(step: FleetStep, ask: Asking, tell: Progress) -> Course:
    """Run a change to its end. If cancelled, it stops where it is: the boards end the change by themselves."""
    coordinator = Coordinator(step)
    legs: list[Leg] = []
    asks = coordinator.start()
    while asks:
        phase, begun = coordinator.phase, time.monotonic()
        asks, slowest, took = await _leg(coordinator, asks, ask, tell)
        legs.append(Leg(phase.value, time.monotonic() - begun, slowest, took))
    return Course(coordinator.outcome(), legs)


async def _leg(coordinator: Coordinator, asks: list[Ask], ask: Asking, tell: Progress) -> tuple[list[Ask], str, float]:
    """Wait until all boards of a phase have answered or timed out; returns the next requests, and the last board."""
    phase, begun, following, last = coordinator.phase, time.monotonic(), [], ("", 0.0)
    tasks = {asyncio.ensure_future(ask(each)): each for each in asks}
    try:
        while tasks and coordinator.phase is phase:  # a majority of the votes is enough
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                asked, answer = tasks.pop(task), task.result()
                if coordinator.phase is phase:
                    last = (asked.board, time.monotonic() - begun)
                    tell(phase.value, asked.board, answer)
                    following += _given(coordinator, asked, answer)
    finally:
        for task in tasks:
            task.cancel()
    assert following or coordinator.phase is Phase.DONE
    return following, *last


def _given(coordinator: Coordinator, ask: Ask, answer: FleetRecord | ErrorInfo) -> list[Ask]:
    if isinstance(answer, ErrorInfo) and answer.code == "no_answer":
        return coordinator.heard_nothing(ask, answer)
    return coordinator.answered(ask, answer)

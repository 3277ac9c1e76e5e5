# SPDX-License-Identifier: Apache-2.0
"""Errors of many boards, always with the names of those concerned."""

from __future__ import annotations

from collections.abc import Mapping

from cm.errors import CmError, NotFound
from cm.networks.fleet.coordinator import SETTLED, Course
from cm.wire.messages.fleet import Decision
from cm.wire.messages.status import ErrorInfo


class NoSuchBoard(NotFound):
    """A board or a label that the fleet does not have."""

    code = "no_such_board"


class FleetRefused(CmError):
    """A change that was refused before anything was touched; `problems` by board."""

    code = "fleet_refused"

    def __init__(self, problems: Mapping[str, ErrorInfo]) -> None:
        super().__init__("nothing was changed: " + told({name: error.message for name, error in problems.items()}))
        self.problems = dict(problems)


class ChangeFailed(CmError):
    """A change that was taken back, or after which not every board is where it is wanted; `course` has each."""

    code = "fleet_change_failed"

    def __init__(self, course: Course) -> None:
        super().__init__(sentence(course))
        self.course = course


def told(said: Mapping[str, str]) -> str:
    """Each board with what is wrong there; boards with the same problem together."""
    boards: dict[str, list[str]] = {}
    for name, why in sorted(said.items()):
        boards.setdefault(why, []).append(name)
    return "; ".join(f"{', '.join(names)}: {why}" for why, names in boards.items())


def sentence(course: Course) -> str:
    """How a change ended, with each board that differs."""
    causes = {name: error.message for name, error in course.causes.items()}
    if course.decision is None:
        return (
            f"what was decided is not known until the store answers ({told(causes)}): boards go where it says, within "
            f"{SETTLED:g} s from then, and `cm fleet status` shows it"
        )
    if not course.touched and course.decision is Decision.REVERT:
        return f"nothing was changed: {told(causes)}"
    if course.leased:
        return (
            f"the change is taken back ({told(causes)}), but its lease stands yet: boards are in the mode before "
            f"within {SETTLED:g} s from when the store can write again, and `cm fleet status` shows it"
        )
    differing = course.differing
    where = "in the new mode" if course.decision is Decision.KEEP else "back in the mode before"
    others = told({name: why for name, why in causes.items() if differing.get(name) != why})
    return f"the fleet is {where}{f' ({others})' if others else ''}" + (
        f", but for {told(differing)}" if differing else ""
    )

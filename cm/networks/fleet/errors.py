# SPDX-License-Identifier: Apache-2.0
"""Errors of many boards, always with the names of those concerned."""

from __future__ import annotations

from collections.abc import Mapping

from cm.errors import CmError, NotFound
from cm.networks.fleet.change.coordinator import Outcome
from cm.wire.messages.status import ErrorInfo


class NoSuchBoard(NotFound):
    """A board or a label that the fleet does not have."""

    code = "no_such_board"


class FleetRefused(CmError):
    """A change that was refused before anything was touched; `problems` by board."""

    code = "fleet_refused"

    def __init__(self, problems: Mapping[str, ErrorInfo]) -> None:
        super().__init__("nothing was changed: " + told(problems))
        self.problems = dict(problems)


class ChangeFailed(CmError):
    """A change that the fleet undid, or that not all boards took part in; `outcome` has each."""

    code = "fleet_change_failed"

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(sentence(outcome))
        self.outcome = outcome


def told(problems: Mapping[str, ErrorInfo]) -> str:
    """Each board with what is wrong there; boards with the same problem together."""
    return _together({name: error.message for name, error in problems.items()})


def _together(said: Mapping[str, str]) -> str:
    boards: dict[str, list[str]] = {}
    for name, why in sorted(said.items()):
        boards.setdefault(why, []).append(name)
    return "; ".join(f"{', '.join(names)}: {why}" for why, names in boards.items())


def sentence(outcome: Outcome) -> str:
    """How a change ended, with each board that differs."""
    differing = _together(outcome.differing)
    if outcome.decision is None:
        return (
            f"what was decided is not known, for too few of its seats ({', '.join(outcome.seats)}) answered. Boards "
            "ask them again, as `cm fleet recover` does; `cm fleet settle` is for when they never come back: "
            + differing
        )
    where = "in the new mode" if outcome.decision.value == "keep" else "back in the mode before"
    if not outcome.records and outcome.decision.value == "revert":
        known = " as far as is known" if outcome.silent else ""
        return f"nothing was changed{known}: {told(outcome.causes)}"
    others = {n: e for n, e in outcome.causes.items() if outcome.differing.get(n) != e.message}
    cause = f" ({told(others)})" if others else ""
    return f"the fleet is {where}{cause}" + (f", but for {differing}" if differing else "")

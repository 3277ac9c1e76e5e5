# SPDX-License-Identifier: Apache-2.0
"""The requests to boards in the course of a change."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from cm.wire.messages.fleet import FleetRecord, FleetStep


class Verb(str, Enum):
    """What a board is asked to do; each is a command of the network (`cm.networks.fleet.verbs`)."""

    PREPARE = "prepare"
    APPLY = "apply"
    VOTE = "vote"
    DECIDE = "decide"
    SETTLE = "settle"


@dataclass(frozen=True, slots=True)
class Ask:
    """A step for a board."""

    board: str
    verb: Verb
    step: FleetStep


AskAll = Callable[[Sequence[Ask]], Awaitable[dict[str, FleetRecord]]]  # records of those that answered with one

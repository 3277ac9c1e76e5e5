# SPDX-License-Identifier: Apache-2.0
"""What the bridges of a fleet tell each other beside their managers' own messages, as frozen data."""

from __future__ import annotations

from enum import Enum

from cm.errors import InvalidRequest
from cm.frozen import dataclass
from cm.wire.messages._proto import BundleState as BundleState
from cm.wire.messages._proto import FetchBundle as FetchBundle
from cm.wire.messages._proto import FleetState as FleetState
from cm.wire.messages._proto import FleetStep as FleetStep
from cm.wire.messages._proto import Status


class Policy(str, Enum):
    """How many boards have to be in the new mode for the change to be kept."""

    ALL = "all"
    QUORUM = "quorum"
    BEST_EFFORT = "best_effort"

    @classmethod
    def of(cls, said: Policy | str) -> Policy:
        """A policy by its name, also with a hyphen or a space in it. Raises InvalidRequest."""
        name = str(getattr(said, "value", said))
        try:
            return cls(name.replace("-", "_").replace(" ", "_"))
        except ValueError:
            known = ", ".join(policy.spelt for policy in cls)
            raise InvalidRequest(f"policy {name!r}: one of {known} is wanted") from None

    @property
    def spelt(self) -> str:
        """The name as users type it."""
        return self.value.replace("_", "-")


class Decision(str, Enum):
    """The outcome of a change, decided once, by one transaction of the store."""

    KEEP = "keep"
    REVERT = "revert"


@dataclass(frozen=True, slots=True)
class BoardStatus:
    """A board's status with what its bridge knows beside it."""

    status: Status
    labels: tuple[str, ...] = ()
    fleet: FleetState | None = None

# SPDX-License-Identifier: Apache-2.0
"""What the bridges of a fleet tell each other beside their managers' own messages, as frozen data."""

from __future__ import annotations

from enum import Enum

from cm.frozen import dataclass
from cm.wire.messages.status import ErrorInfo, Status


class Policy(str, Enum):
    """How many boards have to be in the new mode for the change to be kept."""

    ALL = "all"
    QUORUM = "quorum"
    BEST_EFFORT = "best_effort"

    @classmethod
    def of(cls, said: Policy | str) -> Policy:
        """A policy by its name, also with a hyphen or a space in it. Raises ValueError."""
        name = str(getattr(said, "value", said))
        try:
            return cls(name.replace("-", "_").replace(" ", "_"))
        except ValueError:
            known = ", ".join(policy.spelt for policy in cls)
            raise ValueError(f"policy {name!r}: one of {known} is wanted") from None

    @property
    def spelt(self) -> str:
        """The name as users type it."""
        return self.value.replace("_", "-")


class Decision(str, Enum):
    """The outcome of a change, decided once, by one transaction of the store."""

    KEEP = "keep"
    REVERT = "revert"


@dataclass(frozen=True, slots=True)
class FleetStep:
    """A step of a change of many boards, as its coordinator asks for it; `generation` is the one that it would make."""

    id: str
    config_name: str = ""
    mode: str = ""
    generation: int = 0


@dataclass(frozen=True, slots=True)
class FleetState:
    """How a board stands to what its fleet wants of it; docs/fleet.md explains each `state`.

    `generation` is the newest that it has reached, or that a local change has set aside; `wanted_*` what the store had
    when it was last read, `store_error` why it cannot be read now. `change` is open here. The figures are of that.
    """

    state: str = "free"
    generation: int = 0
    wanted_generation: int = 0
    wanted_config: str = ""
    wanted_mode: str = ""
    wanted_by: str = ""
    change: str = ""
    config_name: str = ""  # where that change goes
    mode: str = ""
    error: ErrorInfo | None = None
    store_error: str = ""
    plan_seconds: float = 0.0
    plan_bytes: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class FetchBundle:
    """An archive that a board is to fetch."""

    sha256: str
    length: int
    name: str = ""


@dataclass(frozen=True, slots=True)
class BundleState:
    """How much of an archive a board has, and the configuration that it became."""

    sha256: str
    length: int
    have: int
    config_name: str = ""
    signer: str = ""
    error: ErrorInfo | None = None


@dataclass(frozen=True, slots=True)
class BoardStatus:
    """A board's status with what its bridge knows beside it."""

    status: Status
    labels: tuple[str, ...] = ()
    fleet: FleetState | None = None

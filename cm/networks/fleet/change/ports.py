# SPDX-License-Identifier: Apache-2.0
"""Protocols of what a participant is given: records on disk, the manager, the other boards, a clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from cm.errors import CmError
from cm.networks.fleet.change.asks import Ask
from cm.wire.messages.fleet import FleetRecord


class Unsettled(CmError):
    """The result of a load is not known yet: the manager went away, or is still loading."""

    code = "unsettled"


@dataclass(frozen=True, slots=True)
class Planned:
    """Where a change would lead, and what it would involve."""

    config_name: str
    mode: str
    seconds: float
    bytes: int


class Store(Protocol):
    """Records on disk. `write` returns when a loss of power would not undo it."""

    def read(self, change: str) -> FleetRecord | None: ...
    def last(self) -> FleetRecord | None: ...
    def write(self, record: FleetRecord) -> None: ...


class OwnBoard(Protocol):
    """The manager, asked in a caller's name. All raise CmError; `load` and `where` raise Unsettled."""

    async def where(self) -> tuple[str, str]: ...
    async def plan(self, config: str, mode: str, caller: str) -> Planned: ...
    async def hold(self, record: FleetRecord) -> None: ...
    async def release(self, record: FleetRecord) -> None: ...
    async def load(self, config: str, mode: str, caller: str) -> float: ...


class Others(Protocol):
    """Other boards of the fleet, asked all at once: the records of those that answer with one."""

    async def ask(self, asks: Sequence[Ask]) -> dict[str, FleetRecord]: ...


class WallClock(Protocol):
    """CLOCK_REALTIME, seconds."""

    def __call__(self) -> float: ...

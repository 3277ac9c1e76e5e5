# SPDX-License-Identifier: Apache-2.0
"""What is around the manager: the streams, time, and an observer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from cm.schema.model import Config
from cm.wire.messages.status import RegValues


class DataPlane(Protocol):
    """The streams, as far as a change has to stop and start them."""

    def quiesce(self, streams: Collection[str]) -> None:
        """Stop these streams; when it returns no transfer of theirs is under way."""

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        """Streams are those of this mode now, where regions hold what `held` says; start again what is listened to."""

    def wrote(self, generation: int) -> None:
        """Registers were written, by requests or a change: frames that begin from now on have this generation."""


class TimeSource(Protocol):
    """The time that passes; Python's module `time` is one, and tests have their own."""

    def monotonic(self) -> float:
        """Seconds."""


class Observer(Protocol):
    """It is told of what changes; called from any thread, must not block."""

    def status_changed(self) -> None:
        """The status differs from before."""

    def progressed(self) -> None:
        """Likewise, in nothing but how far the running change is."""

    def registers_changed(self, values: RegValues) -> None:
        """Registers were written."""

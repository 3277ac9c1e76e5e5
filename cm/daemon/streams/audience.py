# SPDX-License-Identifier: Apache-2.0
"""Who gets frames over ZeroMQ, as streams see it."""

from __future__ import annotations

from typing import Protocol

from cm.daemon.streams.stream import Frame


class Audience(Protocol):
    """The subscribers to frames over ZeroMQ."""

    def wants_stream(self, name: str) -> bool:
        """Whether there are any to a stream."""

    def overruns(self, stream: str) -> int:
        """How often one began to lose a stream's frames."""

    def frame(self, frame: Frame) -> None:
        """Give them a frame; its memory is valid during the call only."""

# SPDX-License-Identifier: Apache-2.0
"""The ZeroMQ subscribers, as streams see them."""

from __future__ import annotations

from typing import Protocol

from cm.server.streams.stream import Frame


class Audience(Protocol):
    """Those who subscribe to frames over ZeroMQ."""

    def wants_stream(self, name: str) -> bool:
        """Whether a stream has subscribers."""

    def overruns(self, stream: str) -> int:
        """How often a subscriber began to lose a stream's frames."""

    def frame(self, frame: Frame) -> None:
        """Send a frame to its subscribers; its memory is valid only during the call."""

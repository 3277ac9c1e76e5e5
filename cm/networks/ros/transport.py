# SPDX-License-Identifier: Apache-2.0
"""What the node needs: a middleware that publishes, subscribes and answers, in ROS's terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from cm.networks.bridge.records import FrameRecord

Values = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service in ROS's terms; `latched`: late subscribers get what was published last (transient local)."""

    depth: int
    reliable: bool = True
    latched: bool = False


LATCHED = Qos(1, latched=True)
EVENTS = Qos(10)
SERVICES = Qos(10)
FRAMES = Qos(5, reliable=False)  # ROS's "sensor data"
RELIABLE_FRAMES = Qos(5)


class Publisher(Protocol):
    """A topic that is published."""

    def write(self, values: Values) -> None:
        """One message."""

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        """One whose last field is the frame's bytes; `head` are the others."""

    def listeners(self) -> int:
        """How many subscribers there are; 1 for any number if the middleware does not say how many."""

    def close(self) -> None:
        """End it; twice is fine."""


class Closing(Protocol):
    """Something that ends."""

    def close(self) -> None:
        """End it; twice is fine."""


class Body(Protocol):
    """The bytes of a frame that came, wherever they lie."""

    length: int

    def into(self, target: npt.NDArray[np.uint8]) -> None:
        """Copy them all; `target` has as many bytes, in one piece."""


class Transport(Protocol):
    """Topics and services of one node.

    Names are whole (``/cm/status``), types as `cm.networks.rmw_zenoh.interfaces` has them.
    """

    def publisher(self, topic: str, kind: str, qos: Qos) -> Publisher:
        """Publish a topic."""

    def frames(self, topic: str, kind: str, qos: Qos, take: Callable[[dict[str, Any], Body], None]) -> Closing:
        """Listen to a topic whose last field is a frame's bytes: `take` gets the other fields, and copies these."""

    def service(self, name: str, kind: str, answer: Callable[[dict[str, Any]], Values]) -> None:
        """Serve: `answer` may take long, since each request has a thread; what it raises is logged."""

# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 node: publishes what the follower reports, and passes requests to the manager."""

from __future__ import annotations

import logging
import re
import threading
import time
from dataclasses import dataclass

from cm.client.board import Board
from cm.errors import InvalidRequest
from cm.networks.bridge.commands import Commands
from cm.networks.bridge.follower import ENDED
from cm.networks.bridge.records import Caller, ConfigRecord
from cm.networks.ros import messages
from cm.networks.ros.action import ChangeModeServer
from cm.networks.ros.parameters import Parameters
from cm.networks.ros.services import Services, Waiting
from cm.networks.ros.streams import Streams
from cm.networks.ros.transport import EVENTS, FRAMES, LATCHED, Qos, Transport
from cm.wire.messages.status import Irq, RegValues, Status

_LOG = logging.getLogger("cm.ros")
_LOOK = 0.25  # seconds between two checks for subscribers to streams
_DIAGNOSTICS = 1.0  # seconds between two diagnostics
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class NodeName:
    """A node's name and namespace (``/``, ``/kria``)."""

    name: str = "cm"
    namespace: str = "/"

    def __post_init__(self) -> None:
        words = [self.name, *(word for word in self.namespace.strip("/").split("/") if word)]
        for word in words:
            if not _NAME.fullmatch(word):
                raise InvalidRequest(f"{word!r} is not a name for ROS: letters, digits and _, and no digit first")
        if not self.namespace.startswith("/"):
            raise InvalidRequest(f"a namespace begins with /, as in /{self.namespace}")

    @property
    def full(self) -> str:
        """``/kria/cm``: what ``~`` stands for."""
        return f"{self.namespace.rstrip('/')}/{self.name}"


class BoardNode:
    """A sink of `cm.networks.bridge.follower`. `look` is called a few times a second, by the thread that made it."""

    def __init__(
        self,
        transport: Transport,
        name: NodeName,
        commands: Commands,
        guest: str = "",
        frames: Qos = FRAMES,
        waiting: int = 24,
    ) -> None:
        """`frames`: the quality of pictures and other frames, both ways; publishers that offer less are not heard.

        `waiting`: how many requests may wait for changes of mode at a time; the transport works on more than that.
        """
        self._transport = transport
        self._own = name.full
        self._lock = threading.Lock()
        self._board: Board | None = None
        self._latest: Status | None = None
        self._problem = ""
        self._next = 0.0
        self._parameters = Parameters(commands, self._own, guest)
        self._streams = Streams(transport, self._own, commands, Caller(guest), frames)
        self._open_topics()
        waits = Waiting(waiting)
        for base, (kind, answer) in {**Services(commands, waits, guest).all(), **self._parameters.all()}.items():
            transport.service(f"{self._own}/{base}", kind, answer)
        ChangeModeServer(transport, f"{self._own}/change_mode", commands, waits, guest)

    def _open_topics(self) -> None:
        publisher, own, ours = self._transport.publisher, self._own, "cm_interfaces/msg/"
        self._status = publisher(f"{own}/status", f"{ours}Status", LATCHED)
        self._configuration = publisher(f"{own}/configuration", f"{ours}Configuration", LATCHED)
        self._registers = publisher(f"{own}/registers", f"{ours}RegisterBank", EVENTS)
        self._interrupts = publisher(f"{own}/interrupts", f"{ours}Interrupt", EVENTS)
        self._diagnostics = publisher("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", EVENTS)
        self._parameter_events = publisher("/parameter_events", "rcl_interfaces/msg/ParameterEvent", EVENTS)

    # ---- what the follower tells ----------------------------------------------------------

    def link(self, board: Board | None, problem: str) -> None:
        if problem not in (self._problem, ENDED):
            _LOG.warning("%s", problem or "the manager is back")
        with self._lock:
            self._board, self._problem = board, problem
            if board is None:
                self._streams.close()
        self._next = 0.0  # so that it is published at once

    def status(self, status: Status, stamp_ns: int) -> None:
        self._latest = status
        self._status.write(messages.status(status, stamp_ns))

    def config(self, record: ConfigRecord) -> None:
        self._parameters.take(record)
        with self._lock:
            if self._board is not None:
                self._streams.take(record, self._board)
        self._configuration.write(messages.configuration(record))

    def registers(self, values: RegValues, stamp_ns: int) -> None:
        self._registers.write(messages.bank(values, stamp_ns))
        self._parameters.event(values, self._parameter_events)

    def interrupt(self, irq: Irq, stamp_ns: int) -> None:
        self._interrupts.write(messages.interrupt(irq, stamp_ns))

    # ---- what goes by the clock -----------------------------------------------------------

    def look(self) -> float:
        """Start and stop streams, tell diagnostics; seconds until the next call."""
        with self._lock:
            self._streams.look()
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + _DIAGNOSTICS
            told = messages.diagnostics(self._own.strip("/"), self._latest, self._problem, time.time_ns())
            self._diagnostics.write(told)
        return _LOOK

    def close(self) -> None:
        """End the streams."""
        with self._lock:
            self._streams.close()

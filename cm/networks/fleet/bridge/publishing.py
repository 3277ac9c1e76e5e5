# SPDX-License-Identifier: Apache-2.0
"""What a manager publishes → publications in the fleet, while anyone listens: status, registers, interrupts, frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from cm.client.aio.relay import Relay, Subscribed
from cm.networks.fleet import keys
from cm.networks.fleet.network import in_loop
from cm.wire import fleet as wire
from cm.wire import topics

BEAT = 1.0  # seconds after which a status that has not changed is published again
_WAITING = 4  # frames that wait here for a slow network; further ones are lost


def encoding(kind: str) -> str:
    """The kind of a payload, in zenoh's terms."""
    return f"application/protobuf;cm.{kind}"


class Publications:
    """The publications of one board; `session` is zenoh's."""

    def __init__(self, board: str, session: Any, relay: Relay, status: Callable[[], bytes]) -> None:
        self._board = board
        self._session = session
        self._relay = relay
        self._status = status  # the last one, with what the bridge adds
        self._publishers: dict[str, Any] = {}
        self._streams: dict[str, Stream] = {}
        self._told = 0.0

    def tell_status(self) -> None:
        """Now, to whoever listens."""
        self._put("status", "Status", self._status)
        self._told = time.monotonic()

    def beat(self) -> None:
        """Publish an unchanged status now and then, so that listeners know that it still holds."""
        if time.monotonic() - self._told >= BEAT * 0.9:
            self.tell_status()

    def tell(self, topic: bytes, message: bytes) -> None:
        """Registers that were written, or an interrupt."""
        if topic == topics.READ_REG:
            for name, value in wire.each_register(message):
                self._put(f"reg/{name}", "RegValues", partial(bytes, value))
        elif topic == topics.IRQ:
            self._put(f"irq/{wire.irq_name(message)}", "Irq", lambda: message)

    def _put(self, rest: str, kind: str, message: Callable[[], bytes]) -> None:
        publisher = self._publishers.get(rest)
        if publisher is None:
            publisher = self._session.declare_publisher(keys.key(self._board, rest))
            self._publishers[rest] = publisher
        if publisher.matching_status.matching:
            publisher.put(message(), encoding=encoding(kind))

    def offer_streams(self, wanted: tuple[str, ...]) -> None:
        """Offer the streams of the mode; each runs while anyone listens."""
        for name in set(self._streams) - set(wanted):
            self._streams.pop(name).end()
        for name in wanted:
            if name not in self._streams:
                publisher = self._session.declare_publisher(keys.key(self._board, "frames", name))
                self._streams[name] = Stream(name, publisher, self._relay)

    def end(self) -> None:
        """Tell nothing more."""
        self.offer_streams(())


class Stream:
    """A stream of the board, subscribed to at the manager as long as anyone subscribes to it here."""

    def __init__(self, name: str, publisher: Any, relay: Relay) -> None:
        self._topic = topics.STREAM_PREFIX + name.encode()
        self._publisher = publisher
        self._relay = relay
        self._subscribed: Subscribed | None = None
        self._listener = publisher.declare_matching_listener(in_loop(lambda status: self._follow(status.matching)))
        self._follow(publisher.matching_status.matching)

    def _follow(self, wanted: bool) -> None:
        if wanted and self._subscribed is None:
            self._subscribed = self._relay.subscribe(self._topic, take=self._came, depth=_WAITING)
        elif not wanted and self._subscribed is not None:
            self._subscribed.close()
            self._subscribed = None

    def _came(self, frames: list[bytes]) -> None:
        if frames[0] == self._topic:  # ZeroMQ matches by prefix
            payload = frames[2] if len(frames) > 2 else b""
            self._publisher.put(payload, encoding="zenoh/bytes", attachment=frames[1])

    def end(self) -> None:
        """Stop, whoever listens."""
        self._follow(False)
        self._listener.undeclare()
        self._publisher.undeclare()

# SPDX-License-Identifier: Apache-2.0
"""What a manager publishes → publications in the fleet, while anyone listens: status, registers, interrupts, frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from cm.client.aio.relay import Relay, Subscribed
from cm.networks.fleet import keys
from cm.networks.fleet.zenoh_session import in_loop, zenoh_module
from cm.wire import fleet as wire
from cm.wire import topics
from cm.wire.encode import decoded
from cm.wire.messages.status import Irq

BEAT = 1.0  # seconds after which a status that has not changed is published again
_WAITING = 4  # frames that wait here for a slow network; further ones are lost


def encoding(kind: str) -> str:
    """The kind of a payload, in zenoh's terms."""
    return f"application/protobuf;cm.{kind}"


class Publisher:
    """Of one key; `heard` while anyone listens: of that it is told, and does not ask with each status."""

    def __init__(self, session: Any, key: str, changed: Callable[[bool], None] = lambda _: None) -> None:
        self._publisher, self._changed, self.heard = session.declare_publisher(key), changed, False
        self.put = self._publisher.put
        told = zenoh_module().handlers.Callback(in_loop(lambda status: self._follow(status.matching)), indirect=False)
        self._listener = self._publisher.declare_matching_listener(told)
        self._follow(self._publisher.matching_status.matching)

    def _follow(self, heard: bool) -> None:
        if heard != self.heard:
            self.heard = heard
            self._changed(heard)

    def end(self) -> None:
        """Whoever listens."""
        self._follow(False)
        self._listener.undeclare()
        self._publisher.undeclare()


@dataclass
class Publications:
    """Those of one board; `session` is zenoh's, `status` the last one, with what the bridge adds."""

    board: str
    session: Any
    relay: Relay
    status: Callable[[], bytes]
    _publishers: dict[str, Publisher] = field(default_factory=dict)
    _streams: dict[str, Stream] = field(default_factory=dict)
    _told: float = 0.0

    def tell_status(self) -> None:
        """Now, to whoever listens."""
        self._put("status", "Status", self.status)
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
            self._put(f"irq/{decoded(Irq, message).name}", "Irq", lambda: message)

    def _put(self, rest: str, kind: str, message: Callable[[], bytes]) -> None:
        if rest not in self._publishers:
            self._publishers[rest] = Publisher(self.session, keys.key(self.board, rest))
        publisher = self._publishers[rest]
        if publisher.heard:
            publisher.put(message(), encoding=encoding(kind))

    def offer_streams(self, wanted: tuple[str, ...]) -> None:
        """Offer the streams of the mode; each runs while anyone listens."""
        for name in set(self._streams) - set(wanted):
            self._streams.pop(name).publisher.end()
        for name in set(wanted) - set(self._streams):
            self._streams[name] = Stream(self.session, keys.key(self.board, "frames", name), self.relay)


class Stream:
    """A stream of the board, subscribed to at the manager as long as anyone subscribes to it here."""

    def __init__(self, session: Any, key: str, relay: Relay) -> None:
        self._topic = topics.STREAM_PREFIX + key.split("/")[-1].encode()
        self._relay = relay
        self._subscribed: Subscribed | None = None
        self.publisher = Publisher(session, key, self._follow)

    def _follow(self, wanted: bool) -> None:
        if wanted:
            self._subscribed = self._relay.subscribe(self._topic, take=self._came, depth=_WAITING)
        elif self._subscribed is not None:
            self._subscribed.close()

    def _came(self, frames: list[bytes]) -> None:
        if frames[0] == self._topic:  # ZeroMQ matches by prefix
            payload = frames[2] if len(frames) > 2 else b""
            self.publisher.put(payload, encoding="zenoh/bytes", attachment=frames[1])

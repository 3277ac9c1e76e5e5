# SPDX-License-Identifier: Apache-2.0
"""A switch in user space that treats frames as networks do: late, lost, out of order, twice, thin, or in one way only.

Each name given is a TAP device of this process. A line of JSON on standard input, such as ``{"port": "b1", "loss":
0.05}``, sets what a port does to what its owner sends and, as to `rate` and `deaf`, gets; the answer is a line of
frames that each port was sent so far.
"""

from __future__ import annotations

import fcntl
import heapq
import itertools
import json
import os
import random
import selectors
import struct
import sys
import time
from dataclasses import dataclass
from typing import Any

_TUNSETIFF, _TAP, _NO_PI = 0x400454CA, 0x0002, 0x1000
_FRAME = 65536


@dataclass
class Port:
    """One device. Times in seconds, shares of frames from 0 to 1."""

    name: str
    file: int
    delay: float = 0.0
    jitter: float = 0.0  # more or less than `delay`, by as much as that
    loss: float = 0.0
    reorder: float = 0.0  # of frames that are not delayed
    double: float = 0.0
    rate: float = 0.0  # bit/s in each direction; 0: without limit
    queue: float = 2.0  # seconds' worth that may wait for the rate
    dumb: bool = False  # nothing that it sends arrives
    deaf: bool = False  # nothing arrives at it
    frames: int = 0  # that reached the switch
    sent_until: float = 0.0
    got_until: float = 0.0


def opened(name: str) -> Port:
    """A TAP device, which goes with this process."""
    file = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(file, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _TAP | _NO_PI))
    return Port(name, file)


class Switch:
    """Learns who is where from the frames themselves."""

    def __init__(self, ports: list[Port]) -> None:
        self._ports = {port.name: port for port in ports}
        self._places: dict[bytes, Port] = {}
        self._waiting: list[tuple[float, int, Port, bytes]] = []
        self._number = itertools.count()
        self._chance = random.Random(0)

    def run(self) -> None:
        """Until standard input ends."""
        ready = selectors.DefaultSelector()
        for port in self._ports.values():
            ready.register(port.file, selectors.EVENT_READ, port)
        ready.register(sys.stdin.fileno(), selectors.EVENT_READ)
        while True:
            self._deliver()
            wait = max(0.0, self._waiting[0][0] - time.monotonic()) if self._waiting else None
            for key, _ in ready.select(wait):
                if key.data is not None:
                    self._read(key.data)
                elif line := sys.stdin.readline():
                    print(json.dumps(self._obey(json.loads(line))), flush=True)
                else:
                    return

    def _obey(self, command: dict[str, Any]) -> dict[str, int]:
        named = command.pop("port", "")
        for port in self._ports.values() if named == "*" else [self._ports[named]] if named else []:
            for what, value in command.items():
                setattr(port, what, value)
            port.sent_until = port.got_until = 0.0
        return {name: port.frames for name, port in self._ports.items()}

    def _read(self, source: Port) -> None:
        for _ in range(64):
            try:
                frame = os.read(source.file, _FRAME)
            except (BlockingIOError, OSError):
                return
            source.frames += 1
            self._places[frame[6:12]] = source
            target = self._places.get(frame[:6])
            if not source.dumb and self._chance.random() >= source.loss:
                for each in [target] if target else self._ports.values():
                    if each is not source and not each.deaf:
                        self._send(source, each, frame)

    def _send(self, source: Port, target: Port, frame: bytes) -> None:
        for _ in range(2 if self._chance.random() < source.double else 1):
            now = at = time.monotonic()
            if source.rate:
                at = max(at, source.sent_until) + 8 * len(frame) / source.rate
                if at - now > source.queue:
                    return
                source.sent_until = at
            if self._chance.random() >= source.reorder:
                at += max(0.0, source.delay + source.jitter * self._chance.uniform(-1, 1))
            if target.rate:
                until = max(at, target.got_until) + 8 * len(frame) / target.rate
                if until - at > target.queue:
                    return
                at = target.got_until = until
            heapq.heappush(self._waiting, (at, next(self._number), target, frame))

    def _deliver(self) -> None:
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            _, _, target, frame = heapq.heappop(self._waiting)
            try:
                os.write(target.file, frame)
            except OSError:
                continue  # its queue is full, or it is down


if __name__ == "__main__":
    switch = Switch([opened(name) for name in sys.argv[1:]])
    print("ready", flush=True)
    switch.run()

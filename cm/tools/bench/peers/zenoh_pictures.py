# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/Image as rmw_zenoh sends it (zenoh, Python): one way to a subscriber, and there and back.

This end is the router, so that whoever joins is one connection away. The far end subscribes as a ROS node would, and
reports over a pipe when each picture arrived. Pictures on the topic of trips it publishes back, as a plain node does.
"""

from __future__ import annotations

import json
import os
import queue
import select
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zenoh

from cm.client.frame import Frame
from cm.errors import CmError
from cm.networks.bridge.records import StreamFormat, frame_record
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.endpoints import ZenohPublisher, quality
from cm.networks.rmw_zenoh.interfaces import type_hash
from cm.networks.rmw_zenoh.key_expressions import End, EndKey, NodeKey
from cm.networks.rmw_zenoh.session import USUAL, opened
from cm.networks.ros.messages import image_head
from cm.networks.ros.transport import FRAMES

KIND = "sensor_msgs/msg/Image"
ONE_WAY, THERE, BACK = "/bench/one_way", "/bench/there", "/bench/back"
_PATIENCE = 60  # seconds, on a loaded machine
_ARRIVED = struct.Struct("<q")


def routing() -> tuple[Any, str]:
    """A session that is the router, and where it listens on this machine's loopback."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        where = f"127.0.0.1:{free.getsockname()[1]}"
    config = zenoh.Config()
    own = {"mode": "router", "connect/endpoints": [], "listen/endpoints": [f"tcp/{where}"]}
    for name, value in {**USUAL, **own}.items():
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config), where


def end(session: Any, topic: str) -> EndKey:
    """A topic of pictures."""
    node = NodeKey(0, str(session.info.zid()), "bench")
    return EndKey(node, 1, End.PUBLISHER, topic, KIND, type_hash(KIND), FRAMES)


class Incoming:
    """Pictures that come, serialised, with the topic of each."""

    def __init__(self, session: Any, *topics: str) -> None:
        self._found: queue.SimpleQueue[tuple[str, bytes]] = queue.SimpleQueue()
        self._subscribers = [session.declare_subscriber(end(session, topic).key, self._into(topic)) for topic in topics]

    def _into(self, topic: str) -> Any:
        return zenoh.handlers.Callback(lambda sample: self._found.put((topic, sample.payload.to_bytes())))

    def take(self, seconds: float) -> tuple[str, bytes] | None:
        """The next one."""
        try:
            return self._found.get(timeout=seconds)
        except queue.Empty:
            return None


class Plain:
    """The yardstick: a publisher in Python that writes header and pixels into a buffer, for zenoh to copy."""

    def __init__(self, session: Any, topic: str) -> None:
        there = end(session, topic)
        self._publisher = session.declare_publisher(there.key, **quality(there))
        self._buffer, self._at = bytearray(), 0

    def matched(self) -> bool:
        """Whether anybody listens."""
        return bool(self._publisher.matching_status.matching)

    def write(self, pixels: npt.NDArray[Any], stamp_ns: int) -> None:
        """One picture of one row."""
        if len(self._buffer) < pixels.nbytes:
            head = {"header": {"frame_id": "from_pl"}, "height": 1, "width": pixels.size, "encoding": "mono8"}
            start = cdr.head(KIND, {**head, "step": pixels.nbytes}, pixels.nbytes)
            self._at = len(start)
            self._buffer = start + bytearray(pixels.nbytes)
            self._pixels = np.frombuffer(self._buffer, np.uint8, pixels.nbytes, self._at)
        struct.pack_into("<iI", self._buffer, 4, *divmod(stamp_ns, 10**9))
        self._pixels[:] = pixels.reshape(-1)
        self._publisher.put(self._buffer)


class PicturesNear:
    """This end: pictures one way, by the bridge's publisher and by the plain one."""

    def __init__(self, folder: Path, size: int) -> None:
        self.session, self.router = routing()
        (folder / "router.new").write_text(self.router)
        (folder / "router.new").rename(folder / "router")
        self._plain = Plain(self.session, ONE_WAY)
        self._ours = ZenohPublisher(self.session, end(self.session, ONE_WAY))
        self._format = StreamFormat("from_pl", False, (1, size), "uint8", "mono8", "from_pl")
        self._pipe = os.open(folder / "arrived", os.O_RDONLY)  # waits for the far end
        until = time.monotonic() + _PATIENCE
        while not self._plain.matched() and time.monotonic() < until:
            time.sleep(0.01)

    def ours(self, frame: Frame) -> float:
        """µs until the subscriber has it, from when the frame is there: record, header, message."""

        def publish() -> None:
            record = frame_record(self._format, frame.reshape(1, -1), frame.info, 0)
            self._ours.write_frame(image_head(record), record)

        return self._timed(publish)

    def plain(self, frame: Frame) -> float:
        """The same by the plain publisher."""
        return self._timed(lambda: self._plain.write(frame.view(np.ndarray), frame.timestamp_ns))

    def _timed(self, publish: Callable[[], None]) -> float:
        """A picture that is lost, as rmw_zenoh loses what the network does not take in 50 ms, is sent again."""
        for _ in range(_PATIENCE):
            while select.select([self._pipe], [], [], 0)[0]:
                os.read(self._pipe, _ARRIVED.size)  # it was late, not lost
            began = time.monotonic_ns()
            publish()
            if select.select([self._pipe], [], [], 1.0)[0]:
                return (int(_ARRIVED.unpack(os.read(self._pipe, _ARRIVED.size))[0]) - began) / 1e3
        raise CmError("no picture arrives over zenoh")

    def close(self) -> None:
        """Nothing more comes."""
        os.close(self._pipe)
        self._ours.close()
        self.session.close()


def near(folder: Path, size: int) -> PicturesNear:
    """This end; returns when the far end listens."""
    return PicturesNear(folder, size)


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end: the subscriber, and the plain echo."""
    os.mkfifo(folder / "arrived")
    ready()
    while not (folder / "router").exists():
        time.sleep(0.01)
    session = opened((folder / "router").read_text())
    back = session.declare_publisher(end(session, BACK).key, **quality(end(session, BACK)))
    incoming = Incoming(session, ONE_WAY, THERE)
    pipe = os.open(folder / "arrived", os.O_WRONLY)
    while True:
        came = incoming.take(_PATIENCE)
        if came is None:
            continue
        if came[0] == ONE_WAY:
            os.write(pipe, _ARRIVED.pack(time.monotonic_ns()))
        else:
            back.put(came[1])

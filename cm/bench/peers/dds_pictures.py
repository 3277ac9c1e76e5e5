# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/Image over cyclonedds (Python): one way to a subscriber, and there and back.

The far end subscribes as a ROS node would, and reports over a pipe when each picture arrived. Pictures on the topic
of trips it publishes back, with two copies, as a plain Python node does.
"""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from cyclonedds._clayer import ddspy_write
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from cm.bridge.formats import frame_record
from cm.bridge.records import StreamFormat
from cm.client.frame import Frame
from cm.dds.library import Library
from cm.dds.local import loopback
from cm.dds.publisher import DdsPublisher
from cm.dds.qos import qos
from cm.dds.types import sample_type
from cm.ros import cdr
from cm.ros.messages import image_head
from cm.ros.transport import IMAGES
from cm.ros.typehash import type_hash

KIND = "sensor_msgs/msg/Image"
ONE_WAY, THERE, BACK = "rt/bench/one_way", "rt/bench/there", "rt/bench/back"
_PATIENCE = 60  # seconds, on a loaded machine
_ARRIVED = struct.Struct("<q")


def domain(folder: Path) -> int:
    """A domain for one use. From 102 on a domain's ports are among Linux's ephemeral ones."""
    return 1 + int.from_bytes(str(folder).encode(), "little") % 101


def join(number: int) -> DomainParticipant:
    """A participant on this machine's loopback alone."""
    os.environ["CYCLONEDDS_URI"] = loopback()
    return DomainParticipant(number)


def writer(participant: DomainParticipant, topic: str) -> DataWriter:
    """Of pictures."""
    return DataWriter(participant, Topic(participant, topic, sample_type(KIND)), qos=qos(IMAGES, type_hash(KIND)))


class Incoming:
    """Pictures that come, serialised."""

    def __init__(self, participant: DomainParticipant, *topics: str) -> None:
        self._waitset = WaitSet(participant)
        self.readers = []
        for topic in topics:
            entity = Topic(participant, topic, sample_type(KIND))
            reader = DataReader(participant, entity, qos=qos(IMAGES, type_hash(KIND)))
            condition = ReadCondition(reader, SampleState.NotRead | ViewState.Any | InstanceState.Alive)
            self._waitset.attach(condition)
            self.readers.append((reader, condition))

    def take(self, seconds: float) -> tuple[int, bytes] | None:
        """The next sample, and the topic that it came on."""
        self._waitset.wait(duration(milliseconds=int(seconds * 1000)))
        for number, (reader, _) in enumerate(self.readers):
            for sample in reader.take(N=1):
                return number, sample.data
        return None


class Plain:
    """The yardstick: a publisher in Python that writes header and pixels into a buffer, for cyclonedds to copy."""

    def __init__(self, end: DataWriter) -> None:
        self._end = end
        self._buffer, self._at = bytearray(), 0

    def write(self, pixels: npt.NDArray[Any], stamp_ns: int) -> None:
        """One picture of one row."""
        if len(self._buffer) < pixels.nbytes:
            head = {"header": {"frame_id": "from_pl"}, "height": 1, "width": pixels.size, "encoding": "mono8"}
            start = cdr.head(KIND, {**head, "step": pixels.nbytes}, pixels.nbytes)
            self._at = len(start)
            self._buffer = start + bytearray(pixels.nbytes + -(self._at + pixels.nbytes) % 4)
            self._pixels = np.frombuffer(self._buffer, np.uint8, pixels.nbytes, self._at)
        struct.pack_into("<iI", self._buffer, 4, *divmod(stamp_ns, 10**9))
        self._pixels[:] = pixels.reshape(-1)
        ddspy_write(self._end._ref, self._buffer)


class PicturesNear:
    """This end: pictures one way, by the bridge's publisher and by the plain one."""

    def __init__(self, folder: Path, size: int) -> None:
        self._participant = join(domain(folder))
        self._end = writer(self._participant, ONE_WAY)
        self._plain = Plain(self._end)
        self._ours = DdsPublisher(self._end, KIND, Library.open(), lambda *_: None)
        self._format = StreamFormat("from_pl", False, (1, size), "uint8", "mono8", "from_pl")
        self._pipe = os.open(folder / "arrived", os.O_RDONLY)  # waits for the far end
        until = time.monotonic() + _PATIENCE
        while not self._end.get_publication_matched_status().current_count and time.monotonic() < until:
            time.sleep(0.01)

    @property
    def copies(self) -> int:
        """The number of copies that the bridge's publisher made of the last frame."""
        return self._ours.copies

    def ours(self, frame: Frame) -> float:
        """µs until the subscriber has it, from when the frame is there: record, header, sample."""
        began = time.monotonic_ns()
        record = frame_record("bench", self._format, frame.reshape(1, -1), frame.info, 0)
        self._ours.write_frame(image_head(record), record)
        return self._since(began)

    def plain(self, frame: Frame) -> float:
        """The same by the plain publisher."""
        began = time.monotonic_ns()
        self._plain.write(frame.view(np.ndarray), frame.timestamp_ns)
        return self._since(began)

    def _since(self, began: int) -> float:
        arrived = int(_ARRIVED.unpack(os.read(self._pipe, _ARRIVED.size))[0])
        return (arrived - began) / 1e3

    def trip(self) -> None:
        """Not of this peer."""
        raise NotImplementedError

    def close(self) -> None:
        """Nothing more comes."""
        os.close(self._pipe)
        self._participant.__del__()


def near(folder: Path, size: int) -> PicturesNear:
    """This end; returns when the far end listens."""
    return PicturesNear(folder, size)


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (any size)
    """The other end: the subscriber, and the plain echo."""
    participant = join(domain(folder))
    incoming = Incoming(participant, ONE_WAY, THERE)
    back = writer(participant, BACK)
    os.mkfifo(folder / "arrived")
    ready()
    pipe = os.open(folder / "arrived", os.O_WRONLY)
    while True:
        came = incoming.take(_PATIENCE)
        if came is None:
            continue
        if came[0] == 0:
            os.write(pipe, _ARRIVED.pack(time.monotonic_ns()))
        else:
            ddspy_write(back._ref, bytearray(came[1]))

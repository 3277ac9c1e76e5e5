# SPDX-License-Identifier: Apache-2.0
"""The node without a network: what it would publish goes into a record, as ``ros2 bag record`` would write it.

It answers nobody. A folder gets MCAP files of the profile ``ros2``, and a metadata.yaml.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cm._version import __version__
from cm.networks.bridge.records import FrameRecord
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.interfaces import definition
from cm.networks.ros import messages
from cm.networks.ros.transport import EVENTS, Closing, Qos, Values
from cm.recording.file import Channel, Data, Schema
from cm.recording.layout import Opened
from cm.recording.record import Limits, Message, Record
from cm.wire.records import Gap

METADATA = "metadata.yaml"
_VERSION = 5  # of metadata.yaml: Humble's, which every later one reads
_DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
_POLICIES = {True: 1, False: 2}  # rmw_qos_policy_kind: reliable, best effort; transient local, volatile


class RecordingTransport:
    """A `cm.networks.ros.transport.Transport` that writes. Threads may share what it makes."""

    def __init__(
        self, folder: Path, board: str, limits: Limits, streams: tuple[str, ...], told: Callable[[str], object]
    ) -> None:
        """`streams`: names of those whose frames are recorded, or ``("all",)``. Raises OSError, InvalidRequest."""
        self._folder, self._board, self._streams = folder, board, streams
        self._topics: dict[str, tuple[str, Qos]] = {}
        self._counts: Counter[str] = Counter()
        self._latched: dict[str, Message] = {}
        self._lock = threading.Lock()
        self._began = self._last = time.time_ns()
        offset = self._began - time.monotonic_ns()
        opened = Opened(board, 0, self._began, offset, "", 0, __version__)
        self.record = Record(folder, limits, opened, time.time_ns, self._state, told, gap=self._gap, profile="ros2")
        self.describe()

    def _state(self, _: Record) -> list[Message]:
        """What late subscribers would get: the last of each latched topic."""
        with self._lock:
            return list(self._latched.values())

    def _gap(self, record: Record, gap: Gap) -> Message:
        data = bytes(cdr.encode(_DIAGNOSTICS, messages.gap(self._board, gap)))
        self._note("/diagnostics", _DIAGNOSTICS, EVENTS, self._last)
        return _channel(record, "/diagnostics", _DIAGNOSTICS, EVENTS), data

    def write(self, topic: str, kind: str, quality: Qos, data: Data) -> None:
        """A message, at the time of now, as ros2 bag has them."""
        now = time.time_ns()
        channel = _channel(self.record, topic, kind, quality)
        self._note(topic, kind, quality, now)
        if quality.latched and isinstance(data, bytes):
            with self._lock:
                self._latched[topic] = channel, data
        self.record.log(channel, data, now)

    def _note(self, topic: str, kind: str, quality: Qos, now: int) -> None:
        with self._lock:
            self._topics[topic] = kind, quality
            self._counts[topic] += 1
            self._last = max(self._last, now)

    def wants(self, topic: str) -> bool:
        """Whether a stream's topic (``/cm/camera/image_raw``) is recorded."""
        name = topic.split("/")[-2]
        return self._streams == ("all",) or name in {stream.replace("-", "_") for stream in self._streams}

    def describe(self) -> None:
        """Write metadata.yaml anew; readers of bags look there first."""
        with self._lock:
            topics, counts = dict(self._topics), Counter(self._counts)
            begin, duration = self._began, self._last - self._began
        files = [path.name for path in self.record.files]
        told = {
            "version": _VERSION,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": duration},
            "starting_time": {"nanoseconds_since_epoch": begin},
            "message_count": counts.total(),
            "topics_with_message_count": [
                {"topic_metadata": _topic(name, *said), "message_count": counts[name]} for name, said in topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": files,
            "files": [
                {
                    "path": name,
                    "starting_time": {"nanoseconds_since_epoch": begin},
                    "duration": {"nanoseconds": duration},
                    "message_count": counts.total() if len(files) == 1 else 0,
                }
                for name in files
            ],
        }
        beside = self._folder / f".{METADATA}"
        beside.write_text(yaml.safe_dump({"rosbag2_bagfile_information": told}, sort_keys=False), encoding="utf-8")
        beside.replace(self._folder / METADATA)

    def close(self) -> None:
        self.record.close()
        self.describe()

    # ---- what a node asks for ----------------------------------------------------------------

    def publisher(self, topic: str, kind: str, quality: Qos) -> _Publisher:
        return _Publisher(self, topic, kind, quality)

    def frames(self, *_: Any, **__: Any) -> Closing:
        """Nobody publishes to a record."""
        return ExitStack()  # nothing is open

    def service(self, *_: Any, **__: Any) -> None:
        """Nobody asks a record."""


def _channel(record: Record, topic: str, kind: str, quality: Qos) -> Channel:
    return record.channels.of(topic, _schema(kind), "cdr", offered_qos_profiles=_offered(quality))


@cache
def _schema(kind: str) -> Schema:
    return Schema(kind, "ros2msg", definition(kind).encode())


class _Publisher:
    """A topic of a record."""

    def __init__(self, transport: RecordingTransport, topic: str, kind: str, quality: Qos) -> None:
        self._transport, self._topic, self._kind, self._quality = transport, topic, kind, quality

    def write(self, values: Values) -> None:
        self._transport.write(self._topic, self._kind, self._quality, bytes(cdr.encode(self._kind, values)))

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        """One whose last field is the frame's bytes, which are written from where they lie."""
        data: Any = np.ascontiguousarray(frame.data)
        begin = cdr.head(self._kind, head, data.nbytes)
        self._transport.write(self._topic, self._kind, self._quality, (bytes(begin), data.data.cast("B")))

    def listeners(self) -> int:
        """1 where the frames are wanted: a stream runs for as long as its topic has listeners."""
        return int(self._transport.wants(self._topic))

    def close(self) -> None:
        """Others may go on."""


@cache
def _offered(quality: Qos) -> str:
    """A quality of service as rosbag2 has it, in metadata.yaml and beside a channel: rosbags compares the two."""
    offered = {
        "history": 1,
        "depth": quality.depth,
        "reliability": _POLICIES[quality.reliable],
        "durability": _POLICIES[quality.latched],
        "deadline": {"sec": 9223372036, "nsec": 854775807},
        "lifespan": {"sec": 9223372036, "nsec": 854775807},
        "liveliness": 1,
        "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
        "avoid_ros_namespace_conventions": False,
    }
    return yaml.safe_dump([offered], sort_keys=False)


def _topic(name: str, kind: str, quality: Qos) -> Mapping[str, Any]:
    offered = _offered(quality)
    return {"name": name, "type": kind, "serialization_format": "cdr", "offered_qos_profiles": offered}

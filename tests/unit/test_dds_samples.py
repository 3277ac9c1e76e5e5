# SPDX-License-Identifier: Apache-2.0
"""Samples of frames, made from a head and pieces of memory with one copy, have the right bytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from cm.bridge.records import FrameRecord
from cm.ros import cdr
from cm.ros.messages import image_head

pytest.importorskip("cyclonedds.domain")
DOMAIN = 101
_LO = "<General><Interfaces><NetworkInterface name='lo'/></Interfaces></General>"
LOCAL = f"<CycloneDDS><Domain>{_LO}</Domain></CycloneDDS>"


@pytest.fixture(scope="module")
def ends() -> Iterator[tuple[Any, Any]]:
    """A writer and a reader of pictures in one process."""
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    from cm.dds.qos import qos
    from cm.dds.types import sample_type
    from cm.ros.transport import IMAGES
    from cm.ros.typehash import type_hash

    domain = Domain(DOMAIN, LOCAL)
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, "rt/eye", sample_type("sensor_msgs/msg/Image"))
    quality = qos(IMAGES, type_hash("sensor_msgs/msg/Image"))
    yield DataWriter(participant, topic, qos=quality), DataReader(participant, topic, qos=quality)
    participant.__del__()
    domain.__del__()


def frame(data: np.ndarray[Any, Any], encoding: str = "mono8") -> FrameRecord:
    rows, columns = data.shape[:2]
    return FrameRecord("b", "eye", 123_456_789_012, 1, "eye", encoding, rows, columns, data.nbytes // rows, data)


WHOLE = np.random.default_rng(3).integers(0, 255, (61, 97, 3), np.uint8)
FRAMES = {
    "in one piece": (WHOLE, "rgb8"),
    "rows of a larger picture": (WHOLE[:, :50], "rgb8"),
    "every other pixel": (WHOLE[::2, ::3, 0], "mono8"),
    "two bytes a pixel": (WHOLE[:, :96, 0].copy().view(np.uint16), "mono16"),
    "read-only": (np.frombuffer(WHOLE.tobytes(), np.uint8).reshape(WHOLE.shape), "rgb8"),
}


@pytest.mark.parametrize("way", ["one copy", "two copies"])
@pytest.mark.parametrize("kind", FRAMES)
def test_a_frame_is_sent_as_it_lies(ends: tuple[Any, Any], kind: str, way: str) -> None:
    from cm.dds.library import Library
    from cm.dds.publisher import DdsPublisher

    writer, reader = ends
    library = Library.open() if way == "one copy" else None
    publisher = DdsPublisher(writer, "sensor_msgs/msg/Image", library, lambda *_: None)
    record = frame(*FRAMES[kind])
    publisher.write_frame(image_head(record), record)
    assert publisher.copies == (1 if library else 2)
    (sample,) = reader.take(N=4)
    wanted = cdr.encode("sensor_msgs/msg/Image", {**image_head(record), "data": record.data.tobytes()})
    assert sample.data[: len(wanted)] == wanted


@pytest.mark.parametrize("way", ["one copy", "two copies"])
def test_a_frame_that_comes_is_copied_to_where_it_is_wanted(ends: tuple[Any, Any], way: str) -> None:
    from cyclonedds._clayer import ddspy_write

    from cm.dds.frames import taking
    from cm.dds.library import Library

    found: list[tuple[dict[str, Any], bytes]] = []

    def take(values: dict[str, Any], body: Any) -> None:
        target = np.zeros(body.length, np.uint8)
        body.into(target)
        found.append((values, target.tobytes()))

    writer, reader = ends
    work = taking(Library.open() if way == "one copy" else None, reader, "sensor_msgs/msg/Image", take)
    for length in (0, 1, 4096, WHOLE.nbytes):
        data = WHOLE.tobytes()[:length]
        fields = {"header": {"frame_id": "x" * (length % 7)}, "height": 1, "width": length, "encoding": "mono8"}
        sample = cdr.encode("sensor_msgs/msg/Image", {**fields, "data": data})
        ddspy_write(writer._ref, sample.ljust(len(sample) + -len(sample) % 4, b"\0"))
        work()
        values, there = found.pop()
        assert (values["width"], values["header"]["frame_id"], there) == (length, "x" * (length % 7), data)
    work()
    assert not found


def test_the_pinned_library_makes_samples_from_pieces() -> None:
    from cm.dds.library import Library

    assert Library.open() is not None, "another cyclonedds: frames are copied twice, see docs/ros2.md"


def test_a_library_that_makes_other_bytes_is_not_used(ends: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    from cm.dds.library import Library, Pieces
    from cm.dds.publisher import DdsPublisher

    made = Pieces._made
    monkeypatch.setattr(Pieces, "_made", lambda self, head, rows, length: made(self, head[:-1] + b"x", rows, length))
    publisher = DdsPublisher(ends[0], "sensor_msgs/msg/Image", Library.open(), lambda *_: None)
    record = frame(WHOLE, "rgb8")
    publisher.write_frame(image_head(record), record)
    assert publisher.copies == 2
    assert len(ends[1].take(N=4)) == 1


def test_another_version_takes_the_way_of_the_python_api(monkeypatch: pytest.MonkeyPatch) -> None:
    from cm.dds import library

    monkeypatch.setattr(library, "version", lambda _: "12.0.0")
    assert library.Library.open() is None

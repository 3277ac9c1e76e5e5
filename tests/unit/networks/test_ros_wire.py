# SPDX-License-Identifier: Apache-2.0
"""ROS interfaces, their hashes and their encoding, against rosbags and what real ROS publishes."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cm.errors import InvalidRequest, NotFound
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.interfaces import Field, _texts, fields_of, type_hash

ROOT = Path(__file__).resolve().parents[3]
ALL = sorted(_texts())

# As `ros2 topic info --verbose` of Jazzy shows them.
PUBLISHED = {
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_msgs/msg/Header": "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
}


@pytest.fixture(scope="module")
def store() -> Any:
    """The type store of rosbags, an independent implementation, with our interfaces added."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for path in sorted((ROOT / "ros2" / "cm_interfaces" / "msg").iterdir()):
        store.register(typesys.get_types_from_msg(path.read_text(), f"cm_interfaces/msg/{path.stem}"))
    return store


def value(field: Field, number: int) -> Any:
    """Something that fits a field, another for each number."""
    if field.many:
        one = Field(field.name, field.kind)
        count = field.length if field.many == "array" else min(number % 3 + 1, field.length or 9)
        found = [value(one, number + index) for index in range(count)]
        return bytes(found) if field.kind in ("uint8", "byte") else found
    if "/" in field.kind:
        return values(field.kind, number)
    if field.kind == "string":
        return "ä€" * (number % 4)
    if field.kind.startswith("float"):
        return number * 0.25
    return bool(number % 2) if field.kind == "bool" else number % 100


def values(name: str, number: int = 1) -> dict[str, Any]:
    """A message whose fields all differ, as far as possible."""
    return {field.name: value(field, number + 3 * at) for at, field in enumerate(fields_of(name))}


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_hashes_are_those_that_real_ros_publishes(name: str) -> None:
    assert type_hash(name) == PUBLISHED[name]


def test_hashes_of_all_are_those_that_rosidl_of_jazzy_wrote() -> None:
    """From the .json files beside the interfaces of a workspace in which cm_interfaces was built by colcon."""
    written = json.loads((ROOT / "tests" / "golden" / "ros_type_hashes.json").read_text())
    assert written.keys() == set(ALL), (
        "an interface is another: build the workspace, and take its hashes (docs/ros2.md)"
    )
    assert {name: type_hash(name) for name in ALL} == written


def test_fields_are_those_of_the_interfaces_as_others_have_them(store: Any) -> None:
    compared = [name for name in ALL if name in store.fielddefs]
    assert len(compared) > 30
    for name in compared:
        assert [field.name for field in fields_of(name)] == [name for name, _ in store.fielddefs[name][1]], name


def test_hashes_are_those_that_others_compute(store: Any) -> None:
    """Except for types with char, which rosbags hashes as char, but rosidl, as we do, as uint8."""
    for name in ALL:
        if name in store.fielddefs and name != "service_msgs/msg/ServiceEventInfo":
            assert type_hash(name) == store.hash_rihs01(name), name


@pytest.mark.parametrize("number", range(5))
def test_bytes_are_those_of_rosbags(store: Any, number: int) -> None:
    compared = 0
    for name in ALL:
        if name in store.fielddefs:
            ours = cdr.encode(name, values(name, number))
            theirs = store.deserialize_cdr(ours, name)
            assert bytes(store.serialize_cdr(theirs, name)).rstrip(b"\0") == ours.rstrip(b"\0"), name
            compared += 1
    assert compared > 30


@pytest.mark.parametrize("name", ALL)
def test_what_is_written_is_read(name: str) -> None:
    wanted = values(name)
    assert plain(cdr.decode(name, cdr.encode(name, wanted))) == plain(wanted)


def plain(thing: Any) -> Any:
    if isinstance(thing, dict):
        return {key: plain(inner) for key, inner in thing.items()}
    if isinstance(thing, (bytes, memoryview)):
        return list(thing)
    return [plain(inner) for inner in thing] if isinstance(thing, (list, tuple)) else thing


def test_a_message_of_the_other_byte_order_is_read() -> None:
    big = b"\0\0\0\0" + (7).to_bytes(4, "big") + (9).to_bytes(4, "big")
    assert cdr.decode("builtin_interfaces/msg/Time", big) == {"sec": 7, "nanosec": 9}


@pytest.mark.parametrize("cut", range(40))
def test_a_message_that_is_cut_short_is_refused(cut: int) -> None:
    whole = cdr.encode("sensor_msgs/msg/Image", {"encoding": "mono8", "data": b"12345"})
    if cut < len(whole):
        with pytest.raises(InvalidRequest):
            cdr.decode("sensor_msgs/msg/Image", whole[:cut])


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(ALL), st.binary(max_size=300), st.booleans())
def test_arbitrary_bytes_are_a_message_or_refused(name: str, data: bytes, little: bool) -> None:
    with suppress(InvalidRequest):
        cdr.decode(name, bytes((0, little, 0, 0)) + data)


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(ALL), st.integers(0, 2000), st.integers(0, 255))
def test_a_changed_byte_gives_another_message_or_an_error(name: str, place: int, byte: int) -> None:
    whole = bytearray(cdr.encode(name, values(name)))
    whole[4 + place % (len(whole) - 4)] = byte
    with suppress(InvalidRequest):
        cdr.decode(name, bytes(whole))


def test_an_impossible_length_is_refused_before_memory_is_allocated() -> None:
    with pytest.raises(InvalidRequest, match="elements"):
        cdr.decode("action_msgs/msg/GoalStatusArray", b"\0\1\0\0\xff\xff\xff\x7f")


def test_values_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="Time"):
        cdr.encode("builtin_interfaces/msg/Time", {"sec": 1 << 40})
    with pytest.raises(InvalidRequest, match="16"):
        cdr.encode("unique_identifier_msgs/msg/UUID", {"uuid": b"1"})


def test_a_pictures_head_followed_by_its_bytes_is_the_picture() -> None:
    pixels = np.arange(35, dtype=np.uint8)
    fields = {"header": {"frame_id": "eye"}, "height": 5, "width": 7, "encoding": "mono8", "step": 7}
    whole = cdr.encode("sensor_msgs/msg/Image", {**fields, "data": pixels.tobytes()})
    assert bytes(cdr.head("sensor_msgs/msg/Image", fields, 35)) + pixels.tobytes() == whole


def test_a_message_without_fields_has_what_rosidl_puts_there() -> None:
    with pytest.raises(NotFound, match="nowhere"):
        fields_of("nowhere/msg/Nothing")
    assert fields_of("cm_interfaces/action/ChangeMode_SendGoal_Request")[1].kind.endswith("ChangeMode_Goal")

# SPDX-License-Identifier: Apache-2.0
"""Keys, tokens, GIDs and attachments, by rmw_zenoh's design document and as rmw_zenoh_cpp wrote them."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")
pytest.importorskip("xxhash")

import zenoh

from cm.errors import InvalidRequest
from cm.networks.rmw_zenoh import cdr
from cm.networks.rmw_zenoh.interfaces import type_hash
from cm.networks.rmw_zenoh.key_expressions import Attachment, End, EndKey, NodeKey
from cm.networks.ros.transport import EVENTS, FRAMES, LATCHED, SERVICES, Qos

STRING, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/Image"
OF_STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
OF_ADD = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"
ADD = "example_interfaces/srv/AddTwoInts"


def test_keys_are_those_of_the_design_document() -> None:
    def key(domain: int, topic: str, kind: str, hash_text: str) -> str:
        return EndKey(NodeKey(domain, "a", "n"), 1, End.PUBLISHER, topic, kind, hash_text, EVENTS).key

    assert key(0, "/chatter", STRING, OF_STRING) == f"0/chatter/std_msgs::msg::dds_::String_/{OF_STRING}"
    assert key(0, "/robot1/chatter", STRING, OF_STRING) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{OF_STRING}"
    add = f"2/add_two_ints/example_interfaces::srv::dds_::AddTwoInts_/{OF_ADD}"
    assert key(2, "/add_two_ints", ADD, OF_ADD) == add


def test_tokens_are_those_of_the_design_document() -> None:
    listener = NodeKey(2, "aac3178e146ba6f1fc6e6a4085e77f21", "listener")
    assert listener.token == "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    assert EndKey(listener, 10, End.SUBSCRIPTION, "/chatter", STRING, OF_STRING, EVENTS).token == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/"
        f"{OF_STRING}/::,10:,:,:,,"
    )
    talker = NodeKey(2, "8b20917502ee955ac4476e0266340d5c", "talker")
    assert EndKey(talker, 10, End.PUBLISHER, "/chatter", STRING, OF_STRING, Qos(7)).token == (
        "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
        f"{OF_STRING}/::,7:,:,:,,"
    )
    server = NodeKey(2, "f9980ee0495eaafb3e38f0d19e2eae12", "add_two_ints_server")
    assert EndKey(server, 10, End.SERVICE, "/add_two_ints", ADD, OF_ADD, SERVICES).token == (
        "@ros2_lv/2/f9980ee0495eaafb3e38f0d19e2eae12/0/10/SS/%/%/add_two_ints_server/%add_two_ints/"
        f"example_interfaces::srv::dds_::AddTwoInts_/{OF_ADD}/::,10:,:,:,,"
    )


# Recorded from a node of rclpy on rmw_zenoh_cpp 0.2.10 (Jazzy): its ends, their tokens, and GIDs where rclpy has them.
TESTER = NodeKey(7, "07105169993718160efa641ed9164dc8", "tester", "/lab")
_START = "@ros2_lv/7/07105169993718160efa641ed9164dc8/0"
_NODE, _STRING = "%/%lab/tester", f"std_msgs::msg::dds_::String_/{OF_STRING}"
_IMAGE = (
    "sensor_msgs::msg::dds_::Image_/RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
)  # fmt: skip
_PLAN = (
    "cm_interfaces::srv::dds_::Plan_/RIHS01_fcb47326277d2d2eadddb82ccda0c55f3fa96b5bf2f6efe2ba29c83cf67f0a0e"
)  # fmt: skip
RECORDED = [
    (3, End.PUBLISHER, "/lab/chatter", STRING, EVENTS, f"{_START}/3/MP/{_NODE}/%lab%chatter/{_STRING}/::,10:,:,:,,",
     "28a9fc1697beb44b767dedac13ceffdd"),
    (7, End.SUBSCRIPTION, "/lab/chatter", STRING, Qos(7), f"{_START}/7/MS/{_NODE}/%lab%chatter/{_STRING}/::,7:,:,:,,",
     "83b3ab7cd47690970c1ed997a9e2137e"),
    (4, End.PUBLISHER, "/late", STRING, LATCHED, f"{_START}/4/MP/{_NODE}/%late/{_STRING}/:1:,1:,:,:,,",
     "35057660010d0667f4ff83a11b9a6cbb"),
    (5, End.PUBLISHER, "/eye/image_raw", IMAGE, FRAMES,
     f"{_START}/5/MP/{_NODE}/%eye%image_raw/{_IMAGE}/2::,5:,:,:,,", "98f7d1d0ff17b14ca625d02757c973e4"),
    (6, End.PUBLISHER, "/lab/usual", STRING, Qos(42), f"{_START}/6/MP/{_NODE}/%lab%usual/{_STRING}/::,:,:,:,,",
     "3e5e917a992a4a6f8e6e4a00f3db7cc8"),
    (8, End.SERVICE, "/lab/plan", "cm_interfaces/srv/Plan", SERVICES,
     f"{_START}/8/SS/{_NODE}/%lab%plan/{_PLAN}/::,10:,:,:,,", None),
    (9, End.CLIENT, "/lab/plan", "cm_interfaces/srv/Plan", SERVICES,
     f"{_START}/9/SC/{_NODE}/%lab%plan/{_PLAN}/::,10:,:,:,,", None),
]  # fmt: skip


@pytest.mark.parametrize(("number", "end", "topic", "kind", "quality", "token", "gid"), RECORDED)
def test_tokens_and_gids_are_those_that_rmw_zenoh_wrote(
    number: int, end: End, topic: str, kind: str, quality: Qos, token: str, gid: str | None
) -> None:
    made = EndKey(TESTER, number, end, topic, kind, type_hash(kind), quality)
    assert made.token == token
    assert gid is None or made.gid.hex() == gid


def test_a_nodes_token_is_the_one_that_rmw_zenoh_wrote() -> None:
    assert TESTER.token == f"{_START}/0/NN/%/%lab/tester"


def test_a_message_and_its_attachment_are_those_that_rmw_zenoh_sent() -> None:
    sent = bytes.fromhex("02000000000000000496d8c7446fea181028a9fc1697beb44b767dedac13ceffdd")
    attachment = Attachment.from_bytes(sent)
    assert (attachment.number, attachment.gid.hex()) == (2, "28a9fc1697beb44b767dedac13ceffdd")
    assert attachment.stamp_ns // 10**9 == 1795369742  # when it was recorded
    assert attachment.to_bytes() == sent
    assert cdr.encode(STRING, {"data": "hello"}) == bytes.fromhex("000100000600000068656c6c6f00")


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_are_those_of_zenohs_own_serializer(number: int, stamp: int, gid: bytes) -> None:
    parts = (zenoh.ext.Int64(number), zenoh.ext.Int64(stamp), gid)
    assert Attachment(number, stamp, gid).to_bytes() == zenoh.ext.z_serialize(parts).to_bytes()


@given(st.binary(max_size=40))
def test_arbitrary_bytes_are_an_attachment_or_refused(data: bytes) -> None:
    with suppress(InvalidRequest):
        assert Attachment.from_bytes(data).to_bytes() == data


def test_attachments_of_older_versions_are_refused_with_a_reason() -> None:
    with pytest.raises(InvalidRequest, match="Jazzy"):
        Attachment.from_bytes(b"\x0fsequence_number\1\0\0\0\0\0\0\0")

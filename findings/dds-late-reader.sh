#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a transient-local writer that keeps ten samples gives a late reader ten.
# Seen: Fast DDS gives ten; Cyclone DDS gives one, because its writer's durability service keeps one by default,
# whatever the history says. Over ROS 2's own layer this does not show, which sets both.
. "$(dirname "$0")/setup"
two_dds ros-std-msgs==5.5.1
python3 - <<'END'
import os
import time
from dataclasses import dataclass

import rclpy
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from saw import saw
from std_msgs.msg import UInt8


@dataclass
class CycloneUInt8(IdlStruct, typename="std_msgs::msg::dds_::UInt8_"):
    data: uint8


rclpy.init()
node = rclpy.create_node("late")
latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
kept = (Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(10))
served = Policy.DurabilityService(duration(seconds=0), Policy.History.KeepLast(10), -1, -1, -1)


def read(take, many: int) -> list[int]:
    """What comes, until there are `many`, or for ten seconds; then for one more."""
    got: list[int] = []
    until = time.monotonic() + 10
    while time.monotonic() < until:
        got += take()
        if len(got) >= many and until > time.monotonic() + 1:
            until = time.monotonic() + 1
        time.sleep(0.02)
    return got


def through_cyclone(topic: str) -> list[int]:
    reader = DataReader(participant, Topic(participant, f"rt/{topic}", CycloneUInt8), Qos(*kept))
    return read(lambda: [sample.data for sample in reader.take(20)], 10)


def through_rclpy(topic: str) -> list[int]:
    got: list[int] = []
    node.create_subscription(UInt8, topic, lambda message: got.append(message.data), latched)

    def take() -> list[int]:
        rclpy.spin_once(node, timeout_sec=0.1)
        new = got[:]
        got.clear()
        return new

    return read(take, 1)


publisher = node.create_publisher(UInt8, "fast", latched)
writers = {}
for topic, policies in (("plain", kept), ("served", (*kept, served))):
    writers[topic] = DataWriter(participant, Topic(participant, f"rt/{topic}", CycloneUInt8), Qos(*policies))
for number in range(10):
    publisher.publish(UInt8(data=number))
    for writer in writers.values():
        writer.write(CycloneUInt8(number))
everything = list(range(10))
saw("of Fast DDS's writer, a late reader of Cyclone DDS", through_cyclone("fast"), everything)
saw("of Cyclone DDS's writer, a late reader of Fast DDS", through_rclpy("plain"), [9])
saw("of Cyclone DDS's writer, one of its own", through_cyclone("plain"), [9])
saw("with a durability service of ten", through_cyclone("served"), everything)
END

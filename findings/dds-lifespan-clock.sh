#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a sample whose time stamp and lifespan have passed by the reader's clock is dropped by every reader, or none.
# Seen: of a writer whose clock is ten seconds behind, Fast DDS's reader gets nothing at all and says nothing; Cyclone
# DDS's gets everything. The same topic lives for one half of a system, as on boards that start without a clock.
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
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from saw import saw
from std_msgs.msg import UInt8


@dataclass
class CycloneUInt8(IdlStruct, typename="std_msgs::msg::dds_::UInt8_"):
    data: uint8


rclpy.init()
node = rclpy.create_node("reader")
by_rclpy: list[int] = []
node.create_subscription(UInt8, "life", lambda message: by_rclpy.append(message.data),
                         QoSProfile(depth=20, lifespan=Duration(seconds=2)))
participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(20), Policy.Lifespan(duration(seconds=2)))
topic = Topic(participant, "rt/life", CycloneUInt8)
reader, writer = DataReader(participant, topic, qos), DataWriter(participant, topic, qos)
until = time.monotonic() + 20
while len(writer.get_matched_subscriptions()) < 2 and time.monotonic() < until:
    time.sleep(0.1)
saw("readers", len(writer.get_matched_subscriptions()), 2)
by_cyclone: list[int] = []
for number, behind in enumerate([0, 0, 0, 10, 10, 10]):
    writer.write(CycloneUInt8(number), time.time_ns() - behind * 10**9)
    for _ in range(5):
        rclpy.spin_once(node, timeout_sec=0.1)
    by_cyclone += [sample.data for sample in reader.take(20)]
saw("got by Cyclone DDS", by_cyclone, [0, 1, 2, 3, 4, 5])
saw("got by Fast DDS", by_rclpy, [0, 1, 2])
END

#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: DDS implementations match by topic, type name and QoS: rclpy and Cyclone DDS exchange any message of ROS 2.
# Seen: since Fast DDS tells its types (ROS 2 Kilted), Cyclone DDS 11 takes a type with an array or a sequence for
# invalid, says so only in its log, and matches nothing. rclpy counts a match, and nothing arrives, either way. With
# the property fastdds.type_propagation=disabled both match.
. "$(dirname "$0")/setup"
two_dds ros-sensor-msgs==5.5.1 ros-unique-identifier-msgs==2.7.0
cat >matched.py <<'END'
import os
import time
from dataclasses import dataclass

import rclpy
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, int32, sequence, uint8, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from saw import saw
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header
from unique_identifier_msgs.msg import UUID


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class CycloneHeader(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class CycloneUuid(IdlStruct, typename="unique_identifier_msgs::msg::dds_::UUID_"):
    uuid: array[uint8, 16]


@dataclass
class CycloneImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: CycloneHeader
    format: str
    data: sequence[uint8]


rclpy.init()
node = rclpy.create_node("seen")
participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
seen = {}
for ours, theirs in ((Header, CycloneHeader), (UUID, CycloneUuid), (CompressedImage, CycloneImage)):
    publisher = node.create_publisher(ours, ours.__name__, 1)
    reader = DataReader(participant, Topic(participant, f"rt/{ours.__name__}", theirs))
    until = time.monotonic() + 20
    while time.monotonic() < until and not publisher.get_subscription_count():
        time.sleep(0.1)
    time.sleep(2)
    seen[ours.__name__] = (publisher.get_subscription_count(), len(reader.get_matched_publications()))
told = "FASTDDS_DEFAULT_PROFILES_FILE" not in os.environ
saw("matches that rclpy and Cyclone DDS see", seen, {"Header": (1, 1), "UUID": (1, 1 - told), "CompressedImage": (1, 1 - told)})
END
cat >untold.xml <<'END'
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com"><profiles><participant profile_name="untold" is_default_profile="true"><rtps>
<propertiesPolicy><properties><property><name>fastdds.type_propagation</name><value>disabled</value></property></properties>
</propertiesPolicy></rtps></participant></profiles></dds>
END
python3 matched.py
FASTDDS_DEFAULT_PROFILES_FILE="$folder/untold.xml" python3 matched.py

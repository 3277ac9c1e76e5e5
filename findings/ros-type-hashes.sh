#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: the type hashes that rosbags reckons are those of ROS 2's own generator, for every common type.
# Seen: they differ for each type that holds a char, which rosidl hashes as a uint8: std_msgs/Char, and the
# service_msgs/ServiceEventInfo that is part of every service's hash.
. "$(dirname "$0")/setup"
pypi ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 ros-std-msgs==5.5.1 ros-diagnostic-msgs==5.5.1 rosbags==0.11.9
export ROS_AUTOMATIC_DISCOVERY_RANGE=OFF ROS_LOG_DIR="$folder/log"
python3 - <<'END'
import importlib
import inspect

import rclpy
from rosbags.typesys import Stores, get_typestore
from saw import saw

rclpy.init()
node = rclpy.create_node("hashes")
store = get_typestore(Stores.ROS2_KILTED)
packages = ("std_msgs", "geometry_msgs", "diagnostic_msgs", "builtin_interfaces", "rcl_interfaces", "lifecycle_msgs", "service_msgs")
same, others = 0, []
for package in packages:
    for name, kind in inspect.getmembers(importlib.import_module(f"{package}.msg"), inspect.isclass):
        publisher = node.create_publisher(kind, f"{package}_{name}", 1)
        (endpoint,) = node.get_publishers_info_by_topic(f"{package}_{name}")
        if str(endpoint.topic_type_hash) == store.hash_rihs01(f"{package}/msg/{name}"):
            same += 1
        else:
            others.append(f"{package}/{name}")
        node.destroy_publisher(publisher)
saw("types of one hash", same, 83)
saw("of two", others, ["std_msgs/Char", "service_msgs/ServiceEventInfo"])
END

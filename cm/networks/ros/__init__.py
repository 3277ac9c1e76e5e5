# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 node, without ROS: its interfaces, how they lie on the wire, and what the node does.

Nothing here knows a middleware: `cm.networks.ros.node` is given one (`cm.networks.rmw_zenoh` is one; `cm_ros2` has
another, over rclpy).
"""

# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 node: what the node does, whatever middleware it is given.

`cm.networks.rmw_zenoh` is one, without ROS; `cm_ros2` has another, over rclpy.
"""

# SPDX-License-Identifier: Apache-2.0
"""A board as a ROS 2 lifecycle node: `cm.networks.ros` over rclpy."""

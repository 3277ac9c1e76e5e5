# SPDX-License-Identifier: Apache-2.0
"""DDS for `cm.ros.node`, over cyclonedds: a participant that ROS 2 tools take for one of their own."""

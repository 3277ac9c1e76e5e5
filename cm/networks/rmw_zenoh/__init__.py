# SPDX-License-Identifier: Apache-2.0
"""zenoh for `cm.networks.ros.node`: a session that nodes of rmw_zenoh take for one of their own, without ROS or DDS."""

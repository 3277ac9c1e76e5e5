# SPDX-License-Identifier: Apache-2.0
"""zenoh for `cm.networks.ros.node`: a session that nodes of rmw_zenoh take for one of their own, without ROS or DDS.

`interfaces` and `cdr` are what ROS's generated code is elsewhere; `keys`, `ends` and `session` are rmw_zenoh's part.
"""

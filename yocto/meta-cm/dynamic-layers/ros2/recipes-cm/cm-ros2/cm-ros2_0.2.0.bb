# SPDX-License-Identifier: MIT
require cm-ros2.inc

SUMMARY = "A board under the FPGA configuration manager as a ROS 2 lifecycle node"
DESCRIPTION = "The topics, services, action and parameters of a board in one rclpy node, with launch files."

ROS_BPN = "cm_ros2"
ROS_EXEC_DEPENDS = "action-msgs cm-interfaces diagnostic-msgs launch launch-ros python3-numpy rcl-interfaces rclpy sensor-msgs"

RDEPENDS:${PN} += "${ROS_EXEC_DEPENDS} python3-fpga-cm-bridge"

inherit ros_ament_python

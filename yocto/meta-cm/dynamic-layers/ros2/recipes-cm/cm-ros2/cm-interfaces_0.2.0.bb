# SPDX-License-Identifier: MIT
require cm-ros2.inc

SUMMARY = "ROS 2 messages, services and action of the FPGA configuration manager"
DESCRIPTION = "The messages of bridges and of the node; subscribers to a board need them too."

ROS_BPN = "cm_interfaces"
ROS_BUILD_DEPENDS = "action-msgs std-msgs"
ROS_BUILDTOOL_DEPENDS = "ament-cmake-native rosidl-default-generators-native"
ROS_EXEC_DEPENDS = "action-msgs rosidl-default-runtime std-msgs"

DEPENDS += "${ROS_BUILD_DEPENDS} ${ROS_BUILDTOOL_DEPENDS}"
RDEPENDS:${PN} += "${ROS_EXEC_DEPENDS}"

inherit ros_ament_cmake

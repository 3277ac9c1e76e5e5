# SPDX-License-Identifier: Apache-2.0
"""One board: ``ros2 launch cm_ros2 board.launch.py [connect:=tcp://kria.local] [namespace:=/kria] [params:=FILE]``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    """The node, and Cyclone DDS set so that it loses no frames, unless it is set already."""
    share = Path(get_package_share_directory("cm_ros2"))
    settings = (share / "config" / "cyclonedds.xml").as_uri()
    return LaunchDescription(
        [
            DeclareLaunchArgument("connect", default_value="", description="tcp://host[:port] or a runtime folder"),
            DeclareLaunchArgument("namespace", default_value="", description="such as /kria"),
            DeclareLaunchArgument("name", default_value="cm", description="the node's name"),
            DeclareLaunchArgument("params", default_value=str(share / "config" / "board.yaml")),
            SetEnvironmentVariable("CYCLONEDDS_URI", EnvironmentVariable("CYCLONEDDS_URI", default_value=settings)),
            LifecycleNode(
                package="cm_ros2",
                executable="board",
                name=LaunchConfiguration("name"),
                namespace=LaunchConfiguration("namespace"),
                parameters=[LaunchConfiguration("params"), {"connect": LaunchConfiguration("connect")}],
                output="screen",
            ),
        ]
    )

# SPDX-License-Identifier: Apache-2.0
"""One board: ``ros2 launch cm_ros2 board.launch.py [connect:=tcp://kria.local] [write:=modes] [namespace:=/kria]``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    """The node, and Cyclone DDS set so that it loses no frames, unless it is set already."""
    config = Path(get_package_share_directory("cm_ros2")) / "config"
    settings = (config / "cyclonedds.xml").as_uri()
    return LaunchDescription(
        [
            DeclareLaunchArgument("connect", default_value="", description="tcp://host[:port] or a runtime folder"),
            DeclareLaunchArgument("write", default_value="", description="modes, registers, frames; or all"),
            DeclareLaunchArgument("namespace", default_value="", description="such as /kria"),
            DeclareLaunchArgument("name", default_value="cm", description="the node's name"),
            DeclareLaunchArgument("params", default_value=str(config / "board.yaml"), description="file of parameters"),
            SetEnvironmentVariable("CYCLONEDDS_URI", EnvironmentVariable("CYCLONEDDS_URI", default_value=settings)),
            OpaqueFunction(function=_node),
        ]
    )


def _node(context: LaunchContext) -> list[LifecycleNode]:
    """What is given here comes before the file; what is not leaves the file's as it is."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ("connect", "write")}
    return [
        LifecycleNode(
            package="cm_ros2",
            executable="board",
            name=LaunchConfiguration("name"),
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("params"), {name: value for name, value in given.items() if value}],
            output="screen",
        )
    ]

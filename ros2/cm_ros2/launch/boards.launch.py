# SPDX-License-Identifier: Apache-2.0
"""Boards in namespaces: ``ros2 launch cm_ros2 boards.launch.py boards:=left=tcp://a,right=tcp://b [write:=modes]``."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    """A node for each board of the argument."""
    described = "NAMESPACE=ADDRESS,NAMESPACE=ADDRESS"
    return LaunchDescription(
        [
            DeclareLaunchArgument("boards", description=described),
            DeclareLaunchArgument("write", default_value="", description="modes, registers, frames; or all"),
            OpaqueFunction(function=_nodes),
        ]
    )


def _nodes(context: LaunchContext) -> list[LifecycleNode]:
    boards, write = (LaunchConfiguration(name).perform(context) for name in ("boards", "write"))
    found = []
    for board in boards.split(","):
        namespace, divider, address = board.partition("=")
        if not divider or not namespace or not address:
            raise ValueError(f"boards: {board!r} is not NAMESPACE=ADDRESS")
        found.append(
            LifecycleNode(
                package="cm_ros2",
                executable="board",
                name="cm",
                namespace=namespace,
                parameters=[{"connect": address, "write": write}],
                output="screen",
            )
        )
    return found

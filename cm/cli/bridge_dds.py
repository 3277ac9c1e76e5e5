# SPDX-License-Identifier: Apache-2.0
"""``cm bridge dds``: a board as a ROS 2 node, without ROS."""

from __future__ import annotations

import argparse
import sys

from cm.cli.bridge_ros import add_node_options, domain_of, end, name_of, serve
from cm.errors import NotInstalled


def add_dds_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "dds",
        help="make a board a ROS 2 node on DDS, without ROS",
        description="Serve the board as a ROS 2 node: topics for any DDS middleware; services, "
        "parameters and the action change_mode for rmw_cyclonedds. docs/ros2.md lists the"
        " names.",
    )
    add_node_options(parser)
    parser.add_argument(
        "--settings", action="store_true", help="print settings for Cyclone DDS with which no frames are lost"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    try:
        from cm.dds import config
        from cm.dds.transport import DdsTransport
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "cyclonedds":
            raise
        raise NotInstalled("cm bridge dds needs cyclonedds: pip install 'fpga-cm[dds]'") from None
    if args.settings:
        sys.stdout.write(config.SHIPPED.read_text("utf-8"))
        return 0
    name = name_of(args)
    transport = DdsTransport(name, domain_of(args))
    try:
        serve(args, transport, name)
    finally:
        transport.close()
    return end()

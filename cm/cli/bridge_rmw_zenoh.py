# SPDX-License-Identifier: Apache-2.0
"""``cm bridge rmw-zenoh``: a board as a ROS 2 node for those that run rmw_zenoh, without ROS and without DDS."""

from __future__ import annotations

import argparse
import logging
import sys

from cm.cli.bridge_ros import add_node_options, domain_of, end, name_of, serve
from cm.errors import NotInstalled


def add_rmw_zenoh_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "rmw-zenoh",
        help="make a board a ROS 2 node for rmw_zenoh, without ROS and without DDS",
        description="Serve the board as a ROS 2 node for nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp, Jazzy or later: "
        "topics, services, parameters and the action change_mode. Like them, it finds others through the zenoh router "
        "on this machine (ros2 run rmw_zenoh_cpp rmw_zenohd, zenohd or cm fleet router), and reads "
        "ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE. docs/ros2.md lists the names.",
    )
    add_node_options(parser)
    parser.add_argument(
        "--router",
        default="",
        metavar="HOST[:PORT]",
        help="send everything through this router instead, such as one on another machine",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    logging.basicConfig(format="cm bridge rmw-zenoh: %(message)s", stream=sys.stderr)
    try:
        from cm.rmw_zenoh.transport import ZenohTransport
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("zenoh", "xxhash"):
            raise
        raise NotInstalled(
            f"cm bridge rmw-zenoh needs eclipse-zenoh and xxhash: pip install 'fpga-cm[zenoh]' ({error})"
        ) from None
    name = name_of(args)
    transport = ZenohTransport(name, domain_of(args), args.router)
    try:
        serve(args, transport, name)
    finally:
        transport.close()
    return end()

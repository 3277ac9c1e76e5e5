# SPDX-License-Identifier: Apache-2.0
"""``cm bridge dds``: a board as a ROS 2 node, without ROS."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING

from cm.cli.common import add_connection_options
from cm.errors import InvalidRequest

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.ros.node import BoardNode, NodeName

_MOST = 232  # domains have numbers to here


def add_dds_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "dds",
        help="make a board a ROS 2 node on DDS, without ROS",
        description="Serve the board as a ROS 2 node: topics for any DDS middleware; services, "
        "parameters and the action change_mode for rmw_cyclonedds. docs/ros2.md lists the"
        " names.",
    )
    add_connection_options(parser)
    parser.add_argument("--name", default="cm", help="the node's name (cm)")
    parser.add_argument("--namespace", default="/", help="the node's namespace, such as /kria (/)")
    parser.add_argument("--domain", type=int, metavar="N", help="the DDS domain (default: $ROS_DOMAIN_ID, or 0)")
    parser.add_argument("--guest", default="", metavar="NAME", help="guest in whose name requests reach the manager")
    parser.add_argument(
        "--best-effort",
        action="store_true",
        help="receive from best-effort publishers too, whose lost frames are not repeated",
    )
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
        raise InvalidRequest("cm bridge dds needs cyclonedds: pip install 'fpga-cm[dds]'") from None
    if args.settings:
        sys.stdout.write(config.SHIPPED.read_text("utf-8"))
        return 0
    name = _name(args)
    transport = DdsTransport(name, _domain(args.domain))
    try:
        _serve(args, transport, name)
    finally:
        transport.close()
    return 0


def _name(args: argparse.Namespace) -> NodeName:
    from cm.ros.node import NodeName

    return NodeName(args.name, args.namespace)


def _domain(given: int | None) -> int:
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if given is None and not text.isdecimal():
        raise InvalidRequest(f"ROS_DOMAIN_ID is {text!r}; a number from 0 to {_MOST} is wanted")
    number = int(text) if given is None else given
    if not 0 <= number <= _MOST:
        raise InvalidRequest(f"domain {number}: a number from 0 to {_MOST} is wanted")
    return number


def _serve(args: argparse.Namespace, transport: object, name: NodeName) -> None:
    from cm.bridge.commands import Commands
    from cm.bridge.follower import Follower
    from cm.client.board import connect
    from cm.ros.node import BoardNode
    from cm.ros.transport import EVENTS, SENSOR_DATA

    def connected(guest: str = "") -> Board:
        return connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys, guest=guest)

    commands = Commands(connected)
    node = BoardNode(transport, name, commands, args.guest, SENSOR_DATA if args.best_effort else EVENTS)  # type: ignore[arg-type]
    follower = Follower(connected, node)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    following = threading.Thread(target=follower.run, name="follower", daemon=True)
    following.start()
    print(f"cm bridge: {name.full}", file=sys.stderr, flush=True)
    try:
        _look(node, ended, following)
    finally:
        follower.stop()
        following.join()
        node.close()
        commands.close()


def _look(node: BoardNode, ended: threading.Event, following: threading.Thread) -> None:
    while not ended.wait(node.look()):
        if not following.is_alive():
            raise InvalidRequest("the bridge's follower has ended; its messages are above")

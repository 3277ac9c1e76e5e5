# SPDX-License-Identifier: Apache-2.0
"""``cm bridge ros``: a board as a ROS 2 node for those that run rmw_zenoh, without ROS and without DDS."""

from __future__ import annotations

import argparse
import logging
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, NoReturn

from cm.cli.common import add_connection_options, interval
from cm.errors import InvalidRequest, NotInstalled
from cm.extras import installing

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.networks.ros.node import BoardNode, NodeName
    from cm.networks.ros.transport import Transport

_MOST = 232  # domains have numbers to here


def add_ros_parser(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "ros",
        help="make a board a ROS 2 node for rmw_zenoh, without ROS and without DDS",
        description="Serve the board as a ROS 2 node for nodes with RMW_IMPLEMENTATION=rmw_zenoh_cpp, Jazzy or later: "
        "topics, services, parameters and the action change_mode. Like them, it finds others through the zenoh router "
        "on this machine (ros2 run rmw_zenoh_cpp rmw_zenohd, zenohd or cm fleet router), and reads ROS_DOMAIN_ID, "
        "ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE. docs/ros2.md lists the names, and says what serves a "
        "board to other middlewares.",
    )
    add_connection_options(parser)
    parser.add_argument("--name", default="cm", help="the node's name (cm)")
    parser.add_argument("--namespace", default="/", help="the node's namespace, such as /kria (/)")
    parser.add_argument(
        "--router",
        default="",
        metavar="HOST[:PORT]",
        help="send everything through this router instead, such as one on another machine",
    )
    parser.add_argument(
        "--write",
        default="",
        metavar="WHAT",
        help="what nodes may change: modes, registers, frames, several with commas between them, or all (default: "
        "nothing); every node that reaches this one may then, see docs/ros2.md",
    )
    parser.add_argument("--guest", default="", metavar="NAME", help="guest in whose name requests reach the manager")
    parser.add_argument(
        "--reliable",
        action="store_true",
        help="repeat frames that are lost, both ways; subscribers and publishers have to be reliable too (default: "
        "best effort, which is ROS's sensor data)",
    )
    parser.add_argument(
        "--patience",
        type=interval,
        default=5.0,
        metavar="SECONDS",
        help="time after which a manager that does not answer counts as gone (5)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    logging.basicConfig(format="cm bridge ros: %(message)s", stream=sys.stderr)
    try:
        from cm.networks.rmw_zenoh.transport import ZenohTransport
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("zenoh", "xxhash"):
            raise
        raise NotInstalled(f"cm bridge ros needs eclipse-zenoh and xxhash: {installing('zenoh')} ({error})") from None
    from cm.networks.bridge.commands import writes_named
    from cm.networks.ros.node import NodeName

    name, writes = NodeName(args.name, args.namespace), writes_named(args.write)
    transport = ZenohTransport(name, domain(), args.router)
    try:
        serve(args, transport, name, writes)
    finally:
        transport.close()
    end()


def domain() -> int:
    """ROS_DOMAIN_ID. Raises InvalidRequest for an invalid one."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > _MOST:
        raise InvalidRequest(f"ROS_DOMAIN_ID is {text!r}; a number from 0 to {_MOST} is wanted")
    return int(text)


def serve(args: argparse.Namespace, transport: Transport, name: NodeName, writes: frozenset[str]) -> None:
    """Until interrupted."""
    from cm.client.board import connect
    from cm.networks.bridge.commands import Commands
    from cm.networks.bridge.follower import Follower
    from cm.networks.ros.node import BoardNode
    from cm.networks.ros.transport import FRAMES, RELIABLE_FRAMES

    def connected(guest: str = "") -> Board:
        return connect(args.connect, runtime_dir=args.runtime_dir, keys=args.keys, guest=guest)

    commands = Commands(connected, writes)
    node = BoardNode(transport, name, commands, args.guest, RELIABLE_FRAMES if args.reliable else FRAMES)
    follower = Follower(connected, node, args.patience)
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
        commands.close()  # before anything that waits for its threads, since it frees those that wait for the manager
        following.join()
        node.close()


def end() -> NoReturn:
    """End the process, whatever its threads are doing.

    Those that answer requests may still use objects of a middleware's library, and a thread inside such a library
    aborts the process when the interpreter shuts down.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _look(node: BoardNode, ended: threading.Event, following: threading.Thread) -> None:
    while not ended.wait(node.look()):
        if not following.is_alive():
            raise InvalidRequest("the bridge's follower has ended; its messages are above")

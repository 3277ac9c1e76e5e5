# SPDX-License-Identifier: Apache-2.0
"""``cm bridge …``: a board in another network."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from cm.cli.bridge_fleet import add_fleet_parser
from cm.cli.bridge_ros import add_ros_parser
from cm.errors import NotInstalled

EXIT_CONFIG = 78  # EX_CONFIG of sysexits(3): the unit does not start it again

_DESCRIPTION = """\
Connect a board to another network: as a ROS 2 node, or as a member of a fleet, both over zenoh. A bridge is a
client like any other, with this user's rights or those of --keys. It runs until it is interrupted, and waits for a
manager that goes away."""


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = _DESCRIPTION
    actions = parser.add_subparsers(dest="action", metavar="NETWORK", required=True)
    add_ros_parser(actions)
    add_fleet_parser(actions)
    for action in actions.choices.values():
        action.set_defaults(run=_final(action.get_default("run")))


def _final(run: Callable[[argparse.Namespace], int]) -> Callable[[argparse.Namespace], int]:
    """`run`, with an exit status of its own if something has to be installed first: trying again does not help."""

    def command(args: argparse.Namespace) -> int:
        try:
            return run(args)
        except NotInstalled as error:
            print(f"cm: {error}", file=sys.stderr)
            return EXIT_CONFIG

    return command

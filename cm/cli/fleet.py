# SPDX-License-Identifier: Apache-2.0
"""``cm fleet``: many boards at once."""

from __future__ import annotations

import argparse

from cm.cli import fleet_boards, fleet_change, fleet_keys, fleet_status
from cm.cli.fleet_options import Intermixed


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "A board is in the fleet's inventory (`cm fleet add`), and there while its bridge (`cm bridge "
        "fleet`) is running. Select boards by name, glob ('line1-*') or label (@camera); the default is all of them."
    )
    kind: type[argparse.ArgumentParser] = Intermixed
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=kind)
    fleet_status.add(actions)
    fleet_boards.add(actions)
    fleet_change.add(actions)
    fleet_boards.add_push(actions)
    fleet_keys.add(actions)

# SPDX-License-Identifier: Apache-2.0
"""``cm fleet``: many boards at once."""

from __future__ import annotations

import argparse

from cm.cli import fleet_change, fleet_keys, fleet_look, fleet_send


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "fleet",
        help="look at many boards, and change them together",
        description="Boards are those whose bridge (`cm bridge zenoh`) is there: named, by glob ('line1-*') or label "
        "(@camera), and all of them where none is named.",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    fleet_look.add(actions)
    fleet_change.add(actions)
    fleet_send.add(actions)
    fleet_keys.add(actions)

# SPDX-License-Identifier: Apache-2.0
"""``cm region map``: what is in a region."""

from __future__ import annotations

import argparse

from cm.cli.region_map import add_map


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("region", help="draw what is configured in a region")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    add_map(actions)

# SPDX-License-Identifier: Apache-2.0
"""``cm config versions|rollback|remove``: earlier versions of configurations, and the end of those that were sent."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from cm.cli.client import connected
from cm.cli.common import add_connection_options, add_json_option, completes, print_json
from cm.cli.import_ import FIRMWARE
from cm.formats.importers import back, versions


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "config",
        help="list and roll back versions of imported configurations, remove sent ones",
        description="List and switch between versions of configurations that `cm import archive` "
        "installed. A running manager takes over the chosen version when it is restarted "
        "or gets SIGHUP (systemctl reload cm). `remove` is for configurations that were "
        "sent with `cm configs --send`.",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("versions", help="list the earlier versions, newest first")
    rollback = actions.add_parser("rollback", help="switch to an earlier version, in one step")
    rollback.add_argument("--to", type=int, metavar="N", help="number of the version (default: the newest)")
    for action, run in ((listing, run_versions), (rollback, run_rollback)):
        completes(action.add_argument("config", metavar="CONFIG"), "<config>")
        action.add_argument(
            "--out", type=Path, metavar="DIR", default=FIRMWARE, help=f"folder of the configurations ({FIRMWARE})"
        )
        add_json_option(action)
        action.set_defaults(run=run)
    remove = actions.add_parser("remove", help="remove a configuration that a client sent")
    completes(remove.add_argument("config", metavar="CONFIG"), "<config>")
    add_connection_options(remove)
    remove.set_defaults(run=run_remove)


def run_versions(args: argparse.Namespace) -> int:
    """List; the exit status."""
    found = versions(args.out, args.config)
    if args.json:
        print_json({"versions": [{"number": v.number, "folder": str(v.folder)} for v in found]})
        return 0
    if not found:
        print(f"no earlier version of configuration {args.config} in {args.out}", file=sys.stderr)
    for version in found:
        print(f"{version.number:>4}  {version.folder}")
    return 0


def run_remove(args: argparse.Namespace) -> int:
    """Remove; the exit status."""
    with connected(args) as board:
        board.remove_config(args.config)
    return 0


def run_rollback(args: argparse.Namespace) -> int:
    """Roll back; the exit status."""
    done = back(args.out / args.config, args.to)
    if args.json:
        print_json({"config": done.config.name, "folder": str(done.folder), "files": list(done.files)})
    else:
        print(f"{done.folder}: an earlier version of {done.config.name} is in force, {len(done.files)} files")
    return 0

# SPDX-License-Identifier: Apache-2.0
"""``cm config versions|rollback``: earlier versions of configurations that archives brought."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.cli.import_ import FIRMWARE
from cm.importers import back, versions


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser(
        "config",
        help="list and roll back versions of imported configurations",
        description="Earlier versions of configurations that `cm import archive` put in place. A manager that runs "
        "takes what is in force at its next start, or with SIGHUP (systemctl reload cm).",
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("versions", help="list the earlier versions, youngest first")
    rollback = actions.add_parser("rollback", help="put an earlier version in force, in one step")
    rollback.add_argument("--to", type=int, metavar="N", help="the version of this number (default: the youngest)")
    for action, run in ((listing, run_versions), (rollback, run_rollback)):
        action.add_argument("config", metavar="CONFIG")
        action.add_argument("--out", type=Path, metavar="DIR", default=FIRMWARE, help=f"below this folder ({FIRMWARE})")
        add_json_option(action)
        action.set_defaults(run=run)


def run_versions(args: argparse.Namespace) -> int:
    """List; the exit status."""
    found = versions(args.out, args.config)
    if args.json:
        print_json({"versions": [{"number": v.number, "folder": str(v.folder)} for v in found]})
        return 0
    for version in found:
        print(f"{version.number:>4}  {version.folder}")
    return 0


def run_rollback(args: argparse.Namespace) -> int:
    """Roll back; the exit status."""
    done = back(args.out / args.config, args.to)
    if args.json:
        print_json({"config": done.config.name, "folder": str(done.folder), "files": list(done.files)})
    else:
        print(f"{done.folder}: an earlier version of {done.config.name} is in force, {len(done.files)} files")
    return 0

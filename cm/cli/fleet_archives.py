# SPDX-License-Identifier: Apache-2.0
"""``cm fleet push``: an archive for many boards."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.common import add_json_option, print_json, print_table
from cm.cli.fleet_options import add_fleet_options, connected_fleet


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    push = actions.add_parser("push", help="send an archive of `cm build collect` to boards, which import it")
    push.add_argument("archive", type=Path, metavar="FILE.tar.gz")
    add_fleet_options(push)
    add_json_option(push)
    push.set_defaults(run=run_push)


def run_push(args: argparse.Namespace) -> int:
    """Send; 0 where every board has put it in force."""
    from cm.cli.connection import plain
    from cm.wire.messages.status import ErrorInfo

    with connected_fleet(args) as fleet:
        found = fleet.push(args.archive, args.boards)
    failed = any(isinstance(each, ErrorInfo) or each.error for each in found.values())
    if args.json:
        print_json({name: plain(each) for name, each in found.items()})
        return int(failed)
    rows = []
    for name, each in found.items():
        if isinstance(each, ErrorInfo):
            rows.append((name, "", "", each.message))
        else:
            rows.append(
                (
                    name,
                    f"{each.have}/{each.length}",
                    each.signer,
                    each.error.message if each.error else each.config_name,
                )
            )
    print_table(rows, ("BOARD", "BYTES", "SIGNED BY", "CONFIGURATION"))
    return int(failed)

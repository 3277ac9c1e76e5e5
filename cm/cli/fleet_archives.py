# SPDX-License-Identifier: Apache-2.0
"""``cm fleet push`` and ``cm fleet cache``: archives for many boards, sent once to each site."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

from cm.cli.common import add_json_option, print_json, print_table
from cm.cli.fleet_options import add_fleet_options, connected_fleet, network_of


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    push = actions.add_parser("push", help="send an archive of `cm build collect` to boards, which import it")
    push.add_argument("archive", type=Path, metavar="FILE.tar.gz")
    add_fleet_options(push)
    add_json_option(push)
    push.set_defaults(run=run_push)
    cache = actions.add_parser("cache", help="keep archives for the boards of a site, beside its router")
    cache.add_argument("site", metavar="SITE")
    cache.add_argument("--folder", type=Path, required=True, metavar="DIR", help="folder for the parts of archives")
    add_fleet_options(cache, boards=False)
    cache.set_defaults(run=run_cache)


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


def run_cache(args: argparse.Namespace) -> int:
    """Serve until interrupted; the exit status."""
    from cm.networks.fleet import keys
    from cm.networks.fleet.bundles import Cache
    from cm.networks.fleet.network import awaited

    over = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: over.set())
    network = awaited(
        network_of(args), over, lambda text: print(f"cm fleet cache: {text}", file=sys.stderr, flush=True)
    )
    if network is None:
        return 0
    with network:
        cache = Cache(network, keys.check(args.site, "site"), args.folder)
        print(f"cm fleet cache: ready for {args.site}", file=sys.stderr, flush=True)
        over.wait()
        cache.close()
    print(f"cm fleet cache: {cache.fetched} bytes fetched, {cache.handed} handed out", file=sys.stderr)
    return 0

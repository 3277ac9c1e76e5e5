# SPDX-License-Identifier: Apache-2.0
"""``cm fleet list|add|remove|store|push``: the inventory of a fleet, where its wanted state lies, and archives."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.cli.common import answer, answer_table, print_json
from cm.cli.fleet_options import ALL, add_fleet_options, answer_boards, connected_fleet

if TYPE_CHECKING:
    from cm.networks.fleet.store import View


def add(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions."""
    ls = actions.add_parser("list", help="list the boards of the fleet: there, away, and not in its inventory")
    add_fleet_options(ls, run_ls)
    for name, run, text in (
        ("add", run_add, "put boards into the inventory (a board with a certificate does so by itself)"),
        ("remove", run_remove, "take boards out of the inventory, for good"),
    ):
        parser = actions.add_parser(name, help=text)
        add_fleet_options(parser, run)
    parser.set_defaults(boards=None)  # who names none does not mean to remove all
    store = actions.add_parser("store", help="show what the fleet wants of its boards")
    verbs = store.add_subparsers(dest="verb", metavar="ACTION", required=True)
    show = verbs.add_parser("show", help="print everything that is in it, as it lies there")
    add_fleet_options(show, run_store, boards=False)


def run_ls(args: argparse.Namespace) -> int:
    """Print the boards; the exit status."""
    with connected_fleet(args) as fleet:
        known, there = fleet.inventory(), set(fleet.boards())
        chosen = sorted({*known, *there}) if args.boards == ALL else fleet.chosen(args.boards)
    if not chosen:
        return answer(args, [], NOBODY)
    rows = []
    for name in chosen:
        seen = ("there" if name in there else "away") if name in known else "there, not in the inventory"
        plain = _plain(known.get(name))
        wanted = f"{plain['config']}/{plain['mode']}" if plain["generation"] else ""
        rows.append((name, seen, wanted, plain["generation"] or "", " ".join(plain["labels"])))
    found = [{"board": n, "there": n in there, "listed": n in known, **_plain(known.get(n))} for n in chosen]
    return answer_table(args, found, rows, ("BOARD", "", "WANTED", "GENERATION", "LABELS"))


NOBODY = "no board is in the inventory, and no board's bridge is running"


def _plain(view: View | None) -> dict[str, Any]:
    wanted = view.wanted if view else None
    settings = view.settings if view else None
    return {
        "config": wanted.config if wanted else "",
        "mode": wanted.mode if wanted else "",
        "generation": wanted.generation if wanted else 0,
        "by": wanted.by if wanted else "",
        "labels": list(settings.labels) if settings else [],
    }


def run_add(args: argparse.Namespace) -> int:
    """Add; 0 where all are in the inventory."""
    with connected_fleet(args) as fleet:
        found = fleet.add(args.boards)
    text = f"added: {', '.join(found)}" if found else "all of these are in the inventory already"
    return answer(args, {"added": found}, text)


def run_remove(args: argparse.Namespace) -> int:
    """Remove; 0 where they are gone."""
    with connected_fleet(args) as fleet:
        gone = fleet.remove(args.boards or ())
    return answer(args, {"removed": gone}, f"removed: {', '.join(gone)}")


def run_store(args: argparse.Namespace) -> int:
    """Show; the exit status."""
    with connected_fleet(args) as fleet:
        print_json({name: entry.value for name, entry in fleet.stored().items()})
    return 0


def add_push(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    push = actions.add_parser("push", help="send an archive of `cm build collect` to boards, which import it")
    push.add_argument("archive", type=Path, metavar="FILE.tar.gz")
    add_fleet_options(push, run_push)


def run_push(args: argparse.Namespace) -> int:
    """Send; 0 where every board has put it in force."""
    begun = time.monotonic()

    def tell(sent: int, whole: int) -> None:
        if sent and sys.stderr.isatty():
            left = (time.monotonic() - begun) * (whole - sent) / sent
            shown = f"\r\033[K{sent} of {whole} bytes are sent, {max(0.0, left):.0f} s more"
            print(shown, end="\n" if sent >= whole else "", file=sys.stderr, flush=True)

    with connected_fleet(args) as fleet:
        found = fleet.push(args.archive, args.boards, tell=tell)

    def row(name: str, each: Any) -> tuple[object, ...]:
        outcome = each.error.message if each.error else each.config_name
        return name, f"{each.have}/{each.length}", each.signer, outcome

    headers = ("BOARD", "BYTES", "SIGNED BY", "CONFIGURATION")
    return answer_boards(args, found, headers, row, lambda each: not each.error)

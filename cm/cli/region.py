# SPDX-License-Identifier: Apache-2.0
"""``cm region``: what a region really holds (`check`), and what it is made of (`map`)."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cm.cli.common import add_connection_options, add_json_option, add_lease_option, completes, print_json, print_table
from cm.cli.region_map import add_map

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cm.client.board import Board
    from cm.wire.messages.status import RegionCheck

_CHECK = """Read the region's configuration back and compare it with the bitstream that was loaded. Exit status: 0 where
it is as it was loaded, or was repaired; 1 where it is not, or nothing of it can be judged."""
_SHOWN = 20  # frames that are listed


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("region", help="compare a region with what was loaded, repair it, draw it")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser("check", help="read a region back and compare it", description=_CHECK)
    completes(check.add_argument("name", metavar="NAME", help="the region"), "<region>")
    check.add_argument("--repair", action="store_true", help="write what is wrong anew, and compare again")
    check.add_argument("--reload", action="store_true", help="repair by loading the whole region again")
    add_lease_option(check)
    add_connection_options(check)
    add_json_option(check)
    check.set_defaults(run=run_check)
    add_map(actions)


def run_check(args: argparse.Namespace) -> int:
    """Compare, and repair if asked; the exit status."""
    from cm.cli.connection import connected, plain

    with connected(args) as board:
        found = board.check_region(args.name, repair=args.repair, reload=args.reload, lease=args.lease)
        places = _places(board, found) if found.wrong else {}
    if args.json:
        told = plain(found)
        for frame, known in zip(told["wrong"], found.wrong, strict=True):
            frame["places"] = [places.get((known.far, bit), "") for bit in known.bits]
        print_json(told)
    else:
        _show(found, places)
    return 0 if found.verdict == "good" else 1


def _places(board: Board, found: RegionCheck) -> Mapping[tuple[int, int], str]:
    """What the wrong bits belong to, where Project X-Ray's database is here and has the device."""
    from cm.client.errors import RequestFailed
    from cm.formats.xray import Database, DatabaseMissing, describe_bits

    try:
        database = Database.open(board.map_region(found.region).device)
    except (DatabaseMissing, RequestFailed):
        return {}
    return describe_bits(database, [(frame.far, bit) for frame in found.wrong for bit in frame.bits])


def _show(found: RegionCheck, places: Mapping[tuple[int, int], str]) -> None:
    took = f"{1000 * found.seconds:.1f} ms"
    print(f"{found.region} ({found.module}): {_verdict(found)}; {found.frames} frames compared in {took}")
    rows = [
        (
            *(f"0x{w.far:08x}", w.row, w.column, w.minor, ", ".join(f"{bit // 32}.{bit % 32}" for bit in w.bits)),
            ", ".join(dict.fromkeys(filter(None, (places.get((w.far, bit), "") for bit in w.bits)))),
        )
        for w in found.wrong[:_SHOWN]
    ]
    if rows:
        print_table(rows, ("FRAME", "ROW", "COLUMN", "MINOR", "WORD.BIT", "PART OF" if places else ""))
    if found.wrong_frames > len(rows):
        print(f"and {found.wrong_frames - len(rows)} more frames")
    if found.unjudged:
        print(f"{found.unjudged} frames cannot be judged")
    if found.why:
        print(found.why)


def _verdict(found: RegionCheck) -> str:
    if found.verdict == "unjudged":
        return "cannot be judged"
    if not found.wrong_bits:
        return "good"
    bits = f"{found.wrong_bits} bit{'s' if found.wrong_bits > 1 else ''} in {found.wrong_frames} frame"
    bits += "s" if found.wrong_frames > 1 else ""
    if not found.repaired:
        return f"{bits} wrong"
    return f"{bits} were wrong; good again, {'written anew' if found.repaired == 'frames' else 'loaded again'}"

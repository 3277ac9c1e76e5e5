# SPDX-License-Identifier: Apache-2.0
"""``cm region``: what a region really holds (`check`), and what it is made of (`map`)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.cli.common import add_board_options, completes, own_lease, print_json, print_table, write_whole
from cm.cli.connection import connected
from cm.errors import NotFound
from cm.frozen import dataclass
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from cm.client.board import Board
    from cm.formats.xray.drawing import Wrong
    from cm.formats.xray.fabric import FabricColumn
    from cm.schema.model import Config
    from cm.wire.messages.status import RegionCheck, RegionMap

_CHECK = """Read the region's configuration back and compare it with the bitstream that was loaded. Exit status: 0 where
it is as it was loaded, or was repaired; 1 where it is not, or nothing of it can be judged."""
_SHOWN = 20  # frames that are listed


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser("check", help="read a region back and compare it", description=_CHECK)
    completes(check.add_argument("name", metavar="NAME", help="the region"), "<region>")
    check.add_argument("--repair", action="store_true", help="write what is wrong again, and compare once more")
    check.add_argument("--reload", action="store_true", help="repair by loading the whole region again")
    add_board_options(check, run_check)
    _add_map(actions)


def run_check(args: argparse.Namespace) -> int:
    """Compare, and repair if asked; the exit status."""
    with connected(args) as board:
        found = board.check_region(args.name, repair=args.repair, reload=args.reload, lease=own_lease())
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
    return f"{bits} were wrong; good again, {'written again' if found.repaired == 'frames' else 'loaded again'}"


# ---- map -------------------------------------------------------------------------


def _add_map(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser(
        "map",
        help="draw a region's frames: its columns, and what is configured where",
        description="Draw the frames of a region of a 7-series device: its columns, and how much of them its module "
        "configures. Kinds of columns and names of tiles are those of Project X-Ray's database, where it is "
        "installed (cm build tools --fetch).",
    )
    completes(parser.add_argument("name", metavar="NAME", help="the region"), "<region>")
    parser.add_argument("--check", action="store_true", help="compare the region first, and show what is wrong red")
    parser.add_argument("--svg", type=Path, metavar="FILE", help="write the picture there (- for stdout)")
    add_board_options(parser, run_map)


def run_map(args: argparse.Namespace) -> int:
    """Print the columns, and write the picture; the exit status."""
    from cm.formats.xray.drawing import columns_of, with_names, wrong_words  # a completed name needs none of this

    with connected(args) as board:
        if args.check:
            board.check_region(args.name)
        region = board.map_region(args.name)
    columns = columns_of(region)
    named = with_names(region.device, columns)
    wrong = wrong_words((one.far, one.bits) for one in region.wrong)
    found = _Map(region, named or columns, wrong, named is not None)
    if args.svg:
        _write(args.svg, found.picture())
    if args.json:
        print_json(found.plain())
    elif args.svg != Path("-"):
        found.show()
    return 0


@dataclass(frozen=True, slots=True)
class _Map:
    of: RegionMap
    columns: Sequence[FabricColumn]
    wrong: Wrong
    named: bool

    def picture(self) -> str:
        from cm.formats.xray.drawing import region_picture

        return region_picture(self.of, self.columns, self.wrong, self.named)

    def plain(self) -> dict[str, Any]:
        columns = [plain(column) for column in self.columns]
        return {**plain(self.of), "columns": columns, "wrong": sorted(self.wrong), "named": self.named}

    def show(self) -> None:
        from cm.formats.xray.drawing import WITHOUT_DATABASE, summary, title

        print(f"{title(self.of)}; {summary(self.of, self.columns, self.wrong)}")
        rows = [(f"{c.address:08X}", c.kind, len(c.bits), sum(c.bits), _bad(c, self.wrong)) for c in self.columns]
        print_table(rows, ("COLUMN", "KIND", "FRAMES", "BITS", "WRONG"))
        if not self.named:
            print(WITHOUT_DATABASE)


def check_region(config: Config, region: str) -> None:
    """Raise NotFound where a configuration has no such region."""
    if region not in config.regions:
        raise NotFound(f"configuration {config.name} has no region {region}; it has {', '.join(config.regions)}")


def _bad(column: FabricColumn, wrong: Wrong) -> int | None:
    return sum(column.address <= address < column.address + len(column.bits) for address in wrong) or None


def _write(path: Path, text: str) -> None:
    if path == Path("-"):
        sys.stdout.write(text)
    else:
        write_whole(path, text.encode())

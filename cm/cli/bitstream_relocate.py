# SPDX-License-Identifier: Apache-2.0
"""``cm bitstream relocate``: a module's bitstream for another region of the same shape."""

from __future__ import annotations

import argparse
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.errors import InvalidRequest, NotFound
from cm.formats.bitstream import Report, footprint_of, inspect, outside
from cm.schema import load
from cm.schema.model import Config


def add_relocate(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "relocate",
        help="move a partial bitstream to another region",
        description="Move a partial bitstream of a 7-series device to another region that has the same columns, as far "
        "as the static part's wires there allow it. Project X-Ray's database says so (cm build tools --fetch).",
    )
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--to", metavar="REGION", required=True, help="the region that it is moved to")
    parser.add_argument(
        "--config", type=Path, metavar="SCHEMA", required=True, help="the runtime schema with both regions' footprints"
    )
    parser.add_argument(
        "--blank",
        type=Path,
        metavar="FILE",
        required=True,
        help="the static part's full bitstream, without modules (build/open/blank.bit of cm build run --flow open)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="the new file (default: FILE's name with the region)")
    add_json_option(parser)
    parser.set_defaults(run=run_relocate)


def run_relocate(args: argparse.Namespace) -> int:
    """Write the moved bitstream; the exit status."""
    from cm.formats.bitstream.memory import frames_in  # these take the database's modules along
    from cm.formats.bitstream.relocate import column_moves, relocate
    from cm.formats.xray import Database

    config, report = load(args.config), inspect(args.file)
    if args.to not in config.regions:
        raise NotFound(f"configuration {config.name} has no region {args.to}; it has {', '.join(config.regions)}")
    here = _region_of(config, report)
    if here == args.to:
        raise InvalidRequest(f"{args.file} is of region {here} already")
    device, blank = frames_in(args.blank)
    moves = column_moves(device, config.regions[here].footprint, config.regions[args.to].footprint)
    data = relocate(args.file, moves, blank, Database.open(device.name))
    out = args.out or args.file.with_name(f"{args.file.stem}_{args.to}{args.file.suffix}")
    out.write_bytes(data)
    if args.json:
        print_json({"file": str(out), "from": here, "to": args.to, "bytes": len(data)})
    else:
        print(f"{out}: moved from {here} to {args.to}, {len(data)} bytes")
    return 0


def _region_of(config: Config, report: Report) -> str:
    """The region whose footprint holds a bitstream. Raises NotFound, InvalidRequest."""
    known = {name: region.footprint for name, region in config.regions.items() if region.footprint}
    if len(known) < len(config.regions):
        lacks = ", ".join(name for name in config.regions if name not in known)
        raise InvalidRequest(f"the schema states no footprint of {lacks}: what lies where is not known")
    for name, footprint in known.items():
        if not outside(report, footprint):
            return name
    wrote = ", ".join(map(str, footprint_of(report))) or "nothing"
    raise NotFound(f"the bitstream is of none of the regions {', '.join(known)}: it writes {wrote}")

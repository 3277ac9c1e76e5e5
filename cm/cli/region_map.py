# SPDX-License-Identifier: Apache-2.0
"""``cm region map``: a region's frames as a table and as a picture."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.cli.common import add_json_option, completes, print_json, print_table
from cm.cli.connection import plain
from cm.errors import InvalidRequest, NotFound
from cm.frozen import dataclass

if TYPE_CHECKING:
    from cm.formats.bitstream.drawing import Wrong
    from cm.formats.bitstream.fabric import FabricColumn
    from cm.schema.model import Config, Module


def add_map(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "map",
        help="draw a region's frames: its columns, and what is configured where",
        description="Draw the frames of a region of a 7-series device: its columns, and how much of them a module "
        "configures. Kinds of columns and names of tiles are those of Project X-Ray's database, where it is "
        "installed (cm build tools --fetch).",
    )
    completes(parser.add_argument("name", metavar="NAME", help="the region"), "<region>")
    parser.add_argument("--config", type=Path, metavar="SCHEMA", required=True, help="the runtime schema that has it")
    parser.add_argument("--module", metavar="NAME", help="what is in it (default: the module of the first mode)")
    parser.add_argument("--check", type=Path, metavar="FILE", help="what `cm region check --json` said: shown red")
    parser.add_argument("--svg", type=Path, metavar="FILE", help="write the picture there (- for stdout)")
    add_json_option(parser)
    parser.set_defaults(run=run_map)


def run_map(args: argparse.Namespace) -> int:
    """Print the columns, and write the picture; the exit status."""
    from cm.formats.bitstream.fabric import fabric  # a completed name needs none of this
    from cm.formats.bitstream.memory import frames_in
    from cm.schema import load
    from cm.schema.files import bitstream_path

    config = load(args.config)
    module = _module(config, args.name, args.module)
    device, frames = frames_in(bitstream_path(config, module))
    database = _database(device.name)
    title = f"Region {args.name} of {config.name}: {module.name}"
    found = _Map(title, device.name, fabric(frames, database), _wrong(args.check), database is not None)
    if args.svg:
        _write(args.svg, found.picture())
    if args.json:
        print_json({"region": args.name, "module": module.name, **found.plain()})
    elif args.svg != Path("-"):
        found.show()
    return 0


@dataclass(frozen=True, slots=True)
class _Map:
    title: str
    device: str
    columns: Sequence[FabricColumn]
    wrong: Wrong
    named: bool

    @property
    def summary(self) -> str:
        bits = [sum(column.bits) for column in self.columns]
        frames = sum(len(column.bits) for column in self.columns)
        bad = f"{len(self.wrong)} of them wrong" if self.wrong else "none known to be wrong"
        return f"{self.device}, {frames} frames with {sum(bits)} bits set, {bad}"

    @property
    def remark(self) -> str:
        from cm.formats.bitstream.drawing import WITHOUT_DATABASE

        return "" if self.named else WITHOUT_DATABASE

    def picture(self) -> str:
        from cm.formats.bitstream.drawing import svg

        return svg(self.columns, self.title, self.wrong, self.remark, [self.summary])

    def plain(self) -> dict[str, Any]:
        columns = [plain(column) for column in self.columns]
        return {"device": self.device, "columns": columns, "wrong": sorted(self.wrong), "remark": self.remark}

    def show(self) -> None:
        print(f"{self.title}; {self.summary}")
        rows = [(f"{c.address:08X}", c.kind, len(c.bits), sum(c.bits), _bad(c, self.wrong)) for c in self.columns]
        print_table(rows, ("COLUMN", "KIND", "FRAMES", "BITS", "WRONG"))
        if self.remark:
            print(self.remark)


def _module(config: Config, region: str, name: str | None) -> Module:
    if region not in config.regions:
        raise NotFound(f"configuration {config.name} has no region {region}; it has {', '.join(config.regions)}")
    own = {one.name: one for one in config.modules.values() if one.region == region}
    if name is None:
        first = config.modes[config.first_mode()].modules
        name = next((one for one in first if one in own), next(iter(own), None))
    if name is None:
        raise NotFound(f"region {region} has no module")
    if name not in own:
        raise NotFound(f"region {region} has no module {name}; it has {', '.join(own)}")
    return own[name]


def _database(device: str) -> Any:
    from cm.formats.xray import Database, DatabaseMissing

    try:
        return Database.open(device)
    except DatabaseMissing:
        return None


def _wrong(path: Path | None) -> Wrong:
    """Frames that a check has found wrong, with their words."""
    if path is None:
        return {}
    try:
        said = json.loads(path.read_text("utf-8"))
        return {int(str(frame["address"]), 0): tuple(map(int, frame["words"])) for frame in said["frames"]}
    except (ValueError, KeyError, TypeError) as error:
        raise InvalidRequest(f"{path} is not what cm region check --json writes: {error!r}") from error


def _bad(column: FabricColumn, wrong: Wrong) -> int | None:
    return sum(column.address <= address < column.address + len(column.bits) for address in wrong) or None


def _write(path: Path, text: str) -> None:
    if path == Path("-"):
        sys.stdout.write(text)
    else:
        path.write_text(text, "utf-8")

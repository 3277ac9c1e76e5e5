# SPDX-License-Identifier: Apache-2.0
"""``cm bitstream verify``: whether a bitstream may be loaded for a purpose."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from cm.cli.common import add_json_option, print_json
from cm.errors import CmError, InvalidRequest, NotFound
from cm.formats.bitstream import (
    BitstreamError,
    Expectation,
    expect_module,
    expect_static,
    footprint_of,
    inspect,
    refusals,
)
from cm.schema import load
from cm.schema.files import bitstream_path
from cm.schema.model import Config, ConfigType, FrameRange, Module

_NO_FOOTPRINT = (
    "its frames were not compared: the footprint of region {} is not known (--like FILE names a bitstream of that "
    "region; `footprint:` in the schema states it)"
)


def add_verify(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the action."""
    parser = actions.add_parser(
        "verify",
        help="check that a bitstream fits a region, or a device",
        description="Check that a bitstream is intact and fits. If it must not be loaded, give the "
        "reasons and exit with status 1.",
    )
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("--config", type=Path, metavar="SCHEMA", help="the runtime schema that it belongs to")
    parser.add_argument("--region", metavar="NAME", help="the region of that configuration")
    parser.add_argument(
        "--like",
        type=Path,
        metavar="FILE",
        help="another bitstream of the same region, whose frames are taken as the region's",
    )
    parser.add_argument("--device", metavar="NAME", help="the device, such as xc7z020")
    parser.add_argument("--idcode", type=_idcode, metavar="HEX", help="its IDCODE in bitstreams, for an unknown device")
    parser.add_argument("--sha256", metavar="HEX", help="the file's expected hash")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--partial", action="store_true", default=None, help="it must be for a region")
    kind.add_argument("--full", dest="partial", action="store_false", help="it must be for the whole device")
    add_json_option(parser)
    parser.set_defaults(run=run_verify)


def _idcode(text: str) -> int:
    value = int(text, 16)
    if not 0 < value <= 0xFFFFFFFF:
        raise argparse.ArgumentTypeError(f"{text} is not an IDCODE: up to eight hexadecimal digits are")
    return value


def run_verify(args: argparse.Namespace) -> int:
    """Print why a bitstream must not be loaded; 0 if it may be."""
    report, expect = inspect(args.file), _expectation(args)
    found = refusals(report, expect)
    blind = _NO_FOOTPRINT if args.region and not expect.footprint else ""
    if args.json:
        reasons = [{"code": item.code, "message": item.message} for item in found]
        print_json(
            {
                "path": str(args.file),
                "good": not found,
                "refusals": reasons,
                "not_compared": ["footprint"] * bool(blind),
            }
        )
    elif found:
        for item in found:
            print(f"{args.file}: {item.code}: {item.message}")
    else:
        print(f"{args.file}: {f'sound, but {blind.format(args.region)}' if blind else 'good'}")
    return 1 if found else 0


def _expectation(args: argparse.Namespace) -> Expectation:
    expect = _from_schema(args.file, load(args.config), args.region) if args.config else _stated(args.region)
    stated = {
        key: getattr(args, key) for key in ("device", "idcode", "partial", "sha256") if getattr(args, key) is not None
    }
    if args.like:
        stated["footprint"] = footprint_of(inspect(args.like))
    return replace(expect, **stated)


def _stated(region: str | None) -> Expectation:
    if region is not None:
        raise InvalidRequest(f"--region {region} needs --config: the runtime schema that has it")
    return Expectation()


def _from_schema(path: Path, config: Config, region: str | None) -> Expectation:
    if region is None:
        if config.type is ConfigType.FULL:
            return expect_static(config)
        raise InvalidRequest(f"--config needs --region: one of {', '.join(config.regions)}")
    if region not in config.regions:
        raise NotFound(f"configuration {config.name} has no region {region}; it has {', '.join(config.regions)}")
    files = _files_of(config, region)
    own = next((module for module, file in files if file.samefile(path)), Module(name=path.stem, region=region))
    return expect_module(config, own, _learned(path, files))


def _files_of(config: Config, region: str) -> list[tuple[Module, Path]]:
    """The region's modules whose bitstreams are here."""
    found = []
    for module in config.modules.values():
        if module.region == region:
            try:
                found.append((module, bitstream_path(config, module)))
            except CmError:
                continue
    return found


def _learned(path: Path, files: list[tuple[Module, Path]]) -> tuple[FrameRange, ...]:
    """The footprint of the region's first sound bitstream, other than the one in question."""
    for _, file in files:
        if not file.samefile(path):
            try:
                report = inspect(file)
            except BitstreamError:
                continue
            if not report.problems:
                return footprint_of(report)
    return ()

# SPDX-License-Identifier: Apache-2.0
"""``cm bitstream inspect|verify|convert|relocate``: files, and what they fit."""

from __future__ import annotations

import argparse
import contextlib
import sys
from functools import partial
from pathlib import Path

from cm.cli.common import add_json_option, answer, is_no_file, naming, parsed, print_json, write_whole
from cm.cli.failures import code_and_sentence, tell
from cm.cli.region import check_region
from cm.errors import CmError, InvalidRequest, NotFound
from cm.formats.bitstream import (
    BitHeader,
    BitstreamError,
    Container,
    Expectation,
    Report,
    convert,
    expect_module,
    expect_static,
    footprint_of,
    inspect,
    open_image,
    outside,
    refusals,
)
from cm.frozen import replace
from cm.schema import load
from cm.schema.model import Config, ConfigType, FrameRange, Module
from cm.schema.named_files import bitstream_path

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
    device = parsed("a device", str.strip, bool)  # not an unset variable, which would let every device pass
    parser.add_argument("--device", type=device, metavar="NAME", help="the device, such as xc7z020")
    parser.add_argument("--idcode", type=_idcode, metavar="HEX", help="its IDCODE in bitstreams, for an unknown device")
    add_json_option(parser, run_verify)


_idcode = parsed("an IDCODE: up to eight hexadecimal digits", partial(int, base=16), lambda code: 0 < code < 1 << 32)


def run_verify(args: argparse.Namespace) -> int:
    """Print why a bitstream must not be loaded; 0 if it may be."""
    report, expect = inspect(args.file), _expectation(args)
    found = refusals(report, expect)
    blind = _NO_FOOTPRINT if args.region and not expect.footprint else ""
    reasons = [{"code": item.code, "message": item.message} for item in found]
    blinded = ["footprint"] * bool(blind)
    verdict = [f"{item.code}: {item.message}" for item in found]
    verdict = verdict or [f"sound, but {blind.format(args.region)}" if blind else "good"]
    told = {"path": str(args.file), "good": not found, "refusals": reasons, "not_compared": blinded}
    answer(args, told, "\n".join(f"{args.file}: {each}" for each in verdict))
    return 1 if found else 0


def _expectation(args: argparse.Namespace) -> Expectation:
    expect = _from_schema(args.file, load(args.config), args.region) if args.config else _stated(args.region)
    stated = {key: getattr(args, key) for key in ("device", "idcode") if getattr(args, key) is not None}
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
    check_region(config, region)
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


_INSTEAD = "name another file"
_FORMS = {form.value: form for form in (Container.BIT, Container.BIN_SWAPPED, Container.BIN_STRAIGHT)}


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    _add_inspect(actions)
    add_verify(actions)
    _add_convert(actions)
    _add_relocate(actions)


def _add_inspect(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser(
        "inspect",
        help="describe bitstreams",
        description="Describe bitstreams. Exit status 1 if one is damaged or cannot be read.",
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a .bit, .bin, .bit.bin or boot image")
    add_json_option(parser, run_inspect)


def _add_convert(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser(
        "convert",
        help="convert a bitstream to another container",
        description="Put a bitstream into another container, byte for byte: bit (big-endian, with a header), bin"
        " (word-swapped, as PCAP and a DMA-fed ICAP read it), bin-straight (big-endian).",
    )
    parser.add_argument("file", type=Path, metavar="FILE")
    parser.add_argument("output", type=Path, metavar="OUTPUT")
    parser.add_argument("--to", choices=sorted(_FORMS), help="the container (default: from the name of OUTPUT)")
    parser.add_argument("--header", type=Path, metavar="FILE", help="for a .bin as input: a .bit whose header is used")
    add_json_option(parser, run_convert)


def run_inspect(args: argparse.Namespace) -> int:
    """Print reports, and errors instead where a file cannot be read; 0 if all bitstreams are sound."""
    told = []
    sound = True
    for path in args.files:
        try:
            with naming(path):
                report = inspect(path)
        except (CmError, OSError) as error:
            sound = False
            code, message = code_and_sentence(error)
            told.append({"path": str(path), "error": {"code": code, "message": message}})
            if not args.json:
                tell(code, message)
            continue
        sound = sound and not report.problems
        told.append({"path": str(path), **report.to_json()})
        if not args.json:
            _print_report(path, report)
    if args.json:
        print_json(told[0] if len(told) == 1 else told)
    return 0 if sound else 1


def _print_report(path: Path, report: Report) -> None:
    kind = "partial" if report.partial else "full"
    extras = [word for word, there in (("compressed", report.compressed), ("encrypted", report.encrypted)) if there]
    idcode = "none" if report.idcode is None else f"{report.idcode:08X}"
    family = report.family.label if report.family else "unknown family"
    print(f"{path}: {report.container.value}, {', '.join([kind, *extras])}, {report.length} bytes")
    print(f"  device    {report.device or 'unknown'} (IDCODE {idcode}, {family})")
    if report.header:
        print(f"  design    {report.design}, part {report.part}, {report.date}")
    print(f"  frames    {report.frames} in {len(report.sections)} section{'s' * (len(report.sections) != 1)}")
    print(f"  crc       {report.crc.value}")
    print(f"  sha256    {report.sha256}")
    for area in footprint_of(report):
        print(f"  footprint {_area(area)}")
    for problem in report.problems:
        print(f"  REFUSED   {problem.code}: {problem.message}")


def _area(area: FrameRange) -> str:
    return f"block type {area.block_type}, row {area.row}, columns {area.column_first} to {area.column_last}"


def run_convert(args: argparse.Namespace) -> int:
    """Write the bitstream in another container."""
    form = _FORMS[args.to] if args.to else _form_by_name(args.output)
    data = convert(args.file, form, _header(args.header))
    _refuse_loss(args.file, args.output, form)
    _write(args.output, data)
    told = {"file": str(args.output), "container": form.value, "bytes": len(data)}
    with contextlib.redirect_stdout(sys.stderr) if is_no_file(args.output) else contextlib.nullcontext():
        return answer(args, told, f"{args.output}: {form.value}, {len(data)} bytes")  # /dev/stdout has the bytes


def _refuse_loss(source: Path, output: Path, form: Container) -> None:
    """Refuse to overwrite the input if the output cannot hold all of it: the rest would be lost."""
    image = open_image(source)
    if not output.exists() or not output.samefile(source):
        return
    if image.container is Container.BOOTGEN:
        raise InvalidRequest(f"{output}: would lose the rest of the boot image; {_INSTEAD}")
    if image.header is not None and form is not Container.BIT:
        header = f"design {image.header.design}, part {image.header.part}, {image.header.date}"
        raise InvalidRequest(f"{output}: would lose the header ({header}), {form.value} has none; {_INSTEAD}")


def _write(output: Path, data: bytes) -> None:
    """The output may be the input."""
    if not output.parent.is_dir():
        raise InvalidRequest(f"{output}: there is no folder {output.parent}")
    write_whole(output, data)


def _form_by_name(output: Path) -> Container:
    forms = {".bit": Container.BIT, ".bin": Container.BIN_SWAPPED}
    if output.suffix not in forms:
        raise InvalidRequest(f"{output}: neither .bit nor .bin; say --to {' or '.join(sorted(_FORMS))}")
    return forms[output.suffix]


def _header(path: Path | None) -> BitHeader | None:
    if path is None:
        return None
    header = open_image(path).header
    if header is None:
        raise InvalidRequest(f"{path}: has no .bit header to take")
    return header


def _add_relocate(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
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
    add_json_option(parser, run_relocate)


def run_relocate(args: argparse.Namespace) -> int:
    """Write the moved bitstream; the exit status."""
    from cm.formats.bitstream.memory import frames_in  # these take the database's modules along
    from cm.formats.bitstream.relocate import column_moves, relocate
    from cm.formats.xray import Database

    config, report = load(args.config), inspect(args.file)
    check_region(config, args.to)
    here = _region_of(config, report)
    if here == args.to:
        raise InvalidRequest(f"{args.file} is of region {here} already")
    device, blank = frames_in(args.blank)
    moves = column_moves(device, config.regions[here].footprint, config.regions[args.to].footprint)
    data = relocate(args.file, moves, blank, Database.open(device.name))
    out = args.out or args.file.with_name(f"{args.file.stem}_{args.to}{args.file.suffix}")
    _write(out, data)
    told = {"file": str(out), "from": here, "to": args.to, "bytes": len(data)}
    return answer(args, told, f"{out}: moved from {here} to {args.to}, {len(data)} bytes")


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

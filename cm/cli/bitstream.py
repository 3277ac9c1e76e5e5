# SPDX-License-Identifier: Apache-2.0
"""``cm bitstream inspect|convert``: what a bitstream is, and its other forms."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from cm.cli.bitstream_verify import add_verify
from cm.cli.common import add_json_option, print_json, print_table
from cm.errors import InvalidRequest
from cm.formats.bitstream import BitHeader, Container, Report, convert, footprint_of, inspect, open_image
from cm.schema.model import FrameRange

_INSTEAD = "name another file, or say --drop-header"
_FORMS = {form.value: form for form in (Container.BIT, Container.BIN_SWAPPED, Container.BIN_STRAIGHT)}


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("bitstream", help="inspect, verify and convert bitstreams")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    _add_inspect(actions)
    add_verify(actions)
    _add_convert(actions)


def _add_inspect(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = actions.add_parser(
        "inspect",
        help="describe bitstreams",
        description="Describe bitstreams. Exit status 1 if one is damaged.",
    )
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a .bit, .bin, .bit.bin or boot image")
    parser.add_argument("--frames", action="store_true", help="list the footprint column by column")
    add_json_option(parser)
    parser.set_defaults(run=run_inspect)


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
    parser.add_argument(
        "--drop-header", action="store_true", help="drop what the output cannot hold, such as the header"
    )
    add_json_option(parser)
    parser.set_defaults(run=run_convert)


def run_inspect(args: argparse.Namespace) -> int:
    """Print reports; 0 if all bitstreams are sound."""
    reports = [(path, inspect(path)) for path in args.files]
    if args.json:
        found = [{"path": str(path), **report.to_json()} for path, report in reports]
        print_json(found[0] if len(found) == 1 else found)
    else:
        for path, report in reports:
            _print_report(path, report, args.frames)
    return 1 if any(report.problems for _, report in reports) else 0


def _print_report(path: Path, report: Report, frames: bool) -> None:
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
    if frames:
        print_table(
            ((item.block_type, item.row, item.column, item.frames) for item in report.footprint),
            ("block type", "row", "column", "frames"),
        )
    else:
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
    if not args.drop_header:
        _refuse_loss(args.file, args.output, form)
    _write(args.output, data)
    if args.json:
        print_json({"file": str(args.output), "container": form.value, "bytes": len(data)})
    else:
        print(f"{args.output}: {form.value}, {len(data)} bytes")
    return 0


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
    """Write whole or not at all, if the output is a file, since it may be the input."""
    if output.exists() and not output.is_file():
        output.write_bytes(data)
        return
    aside = output.with_name(f".{output.name}.new")
    try:
        aside.write_bytes(data)
        if output.exists():
            shutil.copymode(output, aside)
        aside.replace(output.resolve())
    finally:
        aside.unlink(missing_ok=True)


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

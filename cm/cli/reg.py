# SPDX-License-Identifier: Apache-2.0
"""``cm reg list|read|write``: registers by name."""

from __future__ import annotations

import argparse

from cm.cli.client import connected, number, plain
from cm.cli.common import add_connection_options, add_json_option, print_json, print_table
from cm.messages.status import RegisterInfo


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = subparsers.add_parser("reg", help="list, read and write registers")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="the registers of the current mode")
    listing.set_defaults(run=run_list)
    read = actions.add_parser("read", help="read registers or fields (NAME.FIELD); all if none is named")
    read.add_argument("names", metavar="NAME", nargs="*")
    read.set_defaults(run=run_read)
    write = actions.add_parser("write", help="write registers or fields, in order, all checked first")
    write.add_argument("writes", metavar="NAME=VALUE", nargs="+", type=_assignment)
    write.add_argument("--mask", type=number, metavar="BITS", help="change only these bits (one register)")
    write.set_defaults(run=run_write)
    for action in (listing, read, write):
        add_connection_options(action)
        add_json_option(action)


def _assignment(text: str) -> tuple[str, int | str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE, such as focus=2, led.on=0x1 or led.colour=red")
    try:
        return name, number(value)
    except ValueError:
        return name, value  # a field's value by its name


def run_list(args: argparse.Namespace) -> int:
    """Print what the schema says of each register; the exit status."""
    with connected(args) as board:
        found = list(board.registers.info.values())
    if args.json:
        print_json([plain(r) for r in found])
        return 0
    rows = [row for r in found for row in _rows(r)]
    print_table(rows, ("NAME", "ADDRESS", "WIDTH", "ACCESS", "RANGE", "REGION", "MEANING"))
    return 0


def _rows(r: RegisterInfo) -> list[tuple[str, str, int, str, str, str, str]]:
    """A register, and its fields below it."""
    rows = [(r.name, f"{r.address:#x}", r.width, r.access, _limits(r), r.region or "static", r.doc)]
    for f in r.fields:
        names = ", ".join(f"{name}={value}" for name, value in f.values)
        rows.append((f"  .{f.name}", f"bit {f.lsb}", f.width, "", names, "", f.doc))
    return rows


def run_read(args: argparse.Namespace) -> int:
    """Print values; the exit status."""
    with connected(args) as board:
        return _show(args, board.registers.read(*args.names))


def run_write(args: argparse.Namespace) -> int:
    """Write values and print what the registers hold then; the exit status."""
    with connected(args) as board:
        if args.mask is None:
            return _show(args, board.registers.write(dict(args.writes)))
        if len(args.writes) != 1:
            print("cm reg write: --mask goes with one register")
            return 2
        name, value = args.writes[0]
        if not isinstance(value, int):
            print("cm reg write: with --mask the value is a number")
            return 2
        return _show(args, {name: board.registers.write_masked(name, value, args.mask)})


def _show(args: argparse.Namespace, values: dict[str, int]) -> int:
    if args.json:
        print_json(values)
    else:
        print_table([(n, v, f"{v:#x}") for n, v in values.items()], ("NAME", "VALUE", "HEX"))
    return 0


def _limits(r: RegisterInfo) -> str:
    if r.minimum is None and r.maximum is None:
        return ""
    high = (1 << r.width) - 1 if r.maximum is None else r.maximum
    return f"{r.minimum or 0}-{high}"

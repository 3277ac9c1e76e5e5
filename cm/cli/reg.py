# SPDX-License-Identifier: Apache-2.0
"""``cm reg list|read|write|watch``: registers by name."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import TYPE_CHECKING

from cm.cli.common import add_board_options, answer, answer_table, completes, interval, natural, number, own_lease
from cm.cli.connection import check_reader, connected, followed
from cm.client.core import registers
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import FieldInfo, RegisterInfo

if TYPE_CHECKING:
    from cm.client.board import Board


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the registers of the current mode")
    add_board_options(listing, run_list)
    read = actions.add_parser("read", help="read registers or fields (NAME.FIELD); by default all")
    completes(read.add_argument("names", metavar="NAME", nargs="*"), "<register>")
    add_board_options(read, run_read)
    write = actions.add_parser(
        "write", help="write registers or fields, in order; all are checked before the first is written"
    )
    completes(write.add_argument("writes", metavar="NAME=VALUE", nargs="+", type=_assignment), "<assignment>")
    add_board_options(write, run_write)
    watch = actions.add_parser(
        "watch",
        help="print registers as they are written",
        description="Print the values of registers whenever a client writes one. Changes by the "
        "hardware itself are shown only with --every.",
    )
    completes(watch.add_argument("names", metavar="NAME", nargs="*", help="only these (default: all)"), "<register>")
    watch.add_argument(
        "--every", type=interval, metavar="SECONDS", help="read at this interval, and print what has changed"
    )
    watch.add_argument("--count", type=natural, default=0, metavar="N", help="stop after N lines (default: 0, never)")
    add_board_options(watch, run_watch)


def _assignment(text: str) -> tuple[str, int | str]:
    name, equals, value = text.partition("=")
    if not (name and equals and value):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE, such as focus=2, led.on=0x1 or led.colour=red")
    try:
        return name, number(value)
    except ValueError:
        if value.isdecimal():  # as schemas have it: some take 010 for eight
            raise argparse.ArgumentTypeError(f"{value} is ambiguous: {name}={int(value)}, or 0o… for octal") from None
        return name, value  # a field's value by its name


def run_list(args: argparse.Namespace) -> int:
    """Print what the schema says of each register; the exit status."""
    with connected(args) as board:
        found = list(board.registers.info.values())
    rows = [row for r in found for row in _rows(r)]
    headers = ("NAME", "ADDRESS", "WIDTH", "ACCESS", "RANGE", "REGION", "MEANING")
    return answer_table(args, [plain(r) for r in found], rows, headers)


def _rows(r: RegisterInfo) -> list[tuple[str, str, int, str, str, str, str]]:
    """A register, and its fields below it."""
    rows = [(r.name, f"{r.address:#x}", r.width, r.access, _limits(r), r.region or "static", r.doc)]
    for f in r.fields:
        names = ", ".join(f"{name}={value}" for name, value in f.values)
        rows.append((f"  .{f.name}", f"bit {f.lsb}", f.width, f.access, names, "", f.doc))
    return rows


def run_read(args: argparse.Namespace) -> int:
    """Print values; the exit status."""
    with connected(args) as board:
        values = board.registers.read(*args.names)
        info = board.registers.info
    if args.json:
        return _show(args, values)
    rows = [row for name, value in values.items() for row in _read_rows(name, value, info)]
    return answer_table(args, values, rows, ("NAME", "VALUE", "HEX", "MEANS"))


def _read_rows(name: str, value: int, info: Mapping[str, RegisterInfo]) -> list[tuple[str, int, str, str]]:
    """A register with its fields below it, or a field; the names that the schema gives to values."""
    of, _, part = name.partition(".")
    fields = info[of].fields if of in info else ()
    if part:
        return [(name, value, f"{value:#x}", _named(f, value)) for f in fields if f.name == part]
    rows = [(name, value, f"{value:#x}", "")]
    for f in fields:
        if f.access != "wo":
            held = value >> f.lsb & ((1 << f.width) - 1)
            rows.append((f"  .{f.name}", held, f"{held:#x}", _named(f, held)))
    return rows


def _named(field: FieldInfo, value: int) -> str:
    return next((name for name, number in field.values if number == value), "")


def run_write(args: argparse.Namespace) -> int:
    """Write values and print what the registers hold then; the exit status."""
    with connected(args) as board:
        return _show(args, board.registers.write(args.writes, own_lease()))


def run_watch(args: argparse.Namespace) -> int:
    """Print each value as it changes, until interrupted; the exit status."""
    names = tuple(args.names)
    with connected(args) as board:
        values = _written(board, names) if args.every is None else _changed(board, names, args.every)
        for name, value in islice(values, args.count or None):
            answer(args, {"name": name, "value": value}, f"{name} {value}  {value:#x}", lines=True)
    return 0


def _written(board: Board, names: tuple[str, ...]) -> Iterator[tuple[str, int]]:
    """What registers hold after each write of one; names that the mode does not have are an error."""
    if names:
        registers.check(names, board.registers.info.values(), "in this mode")
    for event in followed(board, board.registers.events(*names)):
        for register in event.values:
            values = {register.name: register.value, **{f"{register.name}.{f}": v for f, v in register.fields}}
            yield from ((name, values[name]) for name in (names or (register.name,)) if name in values)


def _changed(board: Board, names: tuple[str, ...], every: float) -> Iterator[tuple[str, int]]:
    """What they hold now, and then whatever differs from the last look."""
    before: dict[str, int] = {}
    while True:
        now = board.registers.read(*names)
        yield from ((name, value) for name, value in now.items() if before.get(name) != value)
        before = now
        time.sleep(every)
        check_reader()


def _show(args: argparse.Namespace, values: dict[str, int]) -> int:
    return answer_table(args, values, [(n, v, f"{v:#x}") for n, v in values.items()], ("NAME", "VALUE", "HEX"))


def _limits(r: RegisterInfo) -> str:
    if r.minimum is None and r.maximum is None:
        return ""
    high = (1 << r.width) - 1 if r.maximum is None else r.maximum
    return f"{r.minimum or 0}-{high}"

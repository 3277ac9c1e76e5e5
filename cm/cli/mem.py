# SPDX-License-Identifier: Apache-2.0
"""``cm mem list|read|write|define``: memories by name."""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cm.cli.arrays import array_of
from cm.cli.common import (
    add_board_options,
    answer,
    answer_table,
    binary_output,
    completes,
    number,
    own_lease,
    print_json,
    write_whole,
)  # fmt: skip
from cm.cli.connection import connected
from cm.errors import InvalidRequest
from cm.wire.messages.json_values import plain
from cm.wire.messages.status import MemoryInfo

_LINE = 16  # bytes of a line of the dump
_STDOUT = Path("-")


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    listing = actions.add_parser("list", help="list the memories of the current mode")
    add_board_options(listing, run_list)
    read = actions.add_parser("read", help="print bytes of a memory, or write them to a file")
    completes(read.add_argument("name", metavar="NAME"), "<memory>")
    _add_offset(read)
    read.add_argument(
        "--length", type=number, metavar="BYTES", help="how many bytes, a multiple of 4 (default: the rest)"
    )
    read.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="a .npy file, or any other name for the plain bytes; - is stdout",
    )
    add_board_options(read, run_read)
    write = actions.add_parser("write", help="write a file or values to a memory")
    completes(write.add_argument("name", metavar="NAME"), "<memory>")
    source = write.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "file", metavar="FILE", nargs="?", type=Path, help="a .npy file, or any other file of plain bytes; - is stdin"
    )
    source.add_argument("--values", metavar="VALUE", nargs="+", help="elements of the memory's type")
    _add_offset(write)
    add_board_options(write, run_write)


def _add_offset(parser: argparse.ArgumentParser) -> None:
    says = "where to begin, in bytes: a multiple of 4 (default: 0)"
    parser.add_argument("--offset", type=number, default=0, metavar="BYTES", help=says)


def run_list(args: argparse.Namespace) -> int:
    """Print what there is to know of each memory; the exit status."""
    with connected(args) as board:
        found = list(board.memories.info.values())
    rows = [
        (m.name, f"{m.address:#x}", m.size, m.access, m.dtype, _form(m), m.region or "static", m.doc) for m in found
    ]
    headers = ("NAME", "ADDRESS", "BYTES", "ACCESS", "DTYPE", "SHAPE", "REGION", "MEANING")
    return answer_table(args, [plain(m) for m in found], rows, headers)


def _form(memory: MemoryInfo) -> str:
    return "x".join(map(str, memory.shape)) or "-"


def run_read(args: argparse.Namespace) -> int:
    """Print a memory, or write it to a file; the exit status."""
    with connected(args) as board:
        array = board.memories[args.name].read(args.offset, args.length)
    if args.output == _STDOUT and not args.json:
        binary_output().write(array.tobytes())
        return 0
    told = {"name": args.name, "offset": args.offset, "length": array.nbytes, "dtype": array.dtype.name}
    if args.output is not None and args.output != _STDOUT:
        _save(args.output, array)
        told["file"] = str(args.output)
    if args.json:
        print_json(told | ({} if "file" in told else {"shape": array.shape, "hex": array.tobytes().hex()}))
    elif args.output is not None:
        print(f"{array.nbytes} bytes of {args.name} in {args.output}")
    else:
        print("\n".join(_dump(array.tobytes(), args.offset)))
    return 0


def _save(path: Path, array: np.ndarray[Any, Any]) -> None:
    data = io.BytesIO()
    if path.suffix == ".npy":
        np.save(data, array)
    write_whole(path, data.getvalue() or array.tobytes())


def _dump(data: bytes, offset: int) -> list[str]:
    """Lines of offset, words as the processor reads them, and letters where bytes are some."""
    lines = []
    for at in range(0, len(data), _LINE):
        part = data[at : at + _LINE]
        words = " ".join(f"{int.from_bytes(part[i : i + 4], 'little'):08x}" for i in range(0, len(part), 4))
        letters = "".join(chr(byte) if 0x20 <= byte < 0x7F else "." for byte in part)
        lines.append(f"{offset + at:08x}  {words:<35}  |{letters}|")
    return lines


def run_write(args: argparse.Namespace) -> int:
    """Write to a memory; the exit status."""
    with connected(args) as board:
        memory = board.memories[args.name]
        data = _values(args.values, memory.info.dtype) if args.file is None else _loaded(args.file)
        length = memory.write(data, args.offset, own_lease())
    told = {"name": args.name, "offset": args.offset, "length": length}
    return answer(args, told, f"{length} bytes written to {args.name}")


def _values(texts: list[str], dtype: str) -> np.ndarray[Any, Any]:
    """Texts as elements: integers as people write them, other numbers as Python does."""
    kinds: dict[str, Callable[[str], Any]] = {"f": float, "c": complex}
    values = []
    for text in texts:
        try:
            values.append(kinds.get(np.dtype(dtype).kind, number)(text))
        except ValueError:
            raise InvalidRequest(f"{text!r} is not a number; the memory has {dtype}") from None
    return np.array(values)


def _loaded(path: Path) -> Any:
    if path == _STDOUT:
        return sys.stdin.buffer.read()
    if path.suffix == ".npy":
        return array_of(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidRequest(f"{path} cannot be read: {error.strerror or error}") from error

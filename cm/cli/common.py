# SPDX-License-Identifier: Apache-2.0
"""What commands share: options, and output for people and for scripts."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Coroutine, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, TypeVar

from cm.cli.colours import painted
from cm.errors import CmError, InvalidRequest

_T = TypeVar("_T")
Run = Callable[[argparse.Namespace], int]  # a command; returns the exit status


def completes(argument: argparse.Action, *words: str) -> None:
    """Offer `words` at Tab, and for ``<KIND>`` the names of what runs (`cm.cli.completion`)."""
    argument.completer = partial(_offered, words)  # type: ignore[attr-defined]  # where argcomplete looks for it


def _offered(words: Sequence[str], prefix: str, parsed_args: argparse.Namespace, **_: object) -> list[str]:
    from cm.cli.completion import offered

    return offered(words, prefix, parsed_args)


def add_connection_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--runtime-dir`` and ``--connect``: which configuration manager to talk to."""
    group = parser.add_argument_group("connection")
    choice = group.add_mutually_exclusive_group()
    choice.add_argument(
        "--runtime-dir",
        type=Path,
        metavar="DIR",
        help="folder of the manager's sockets (default: $CM_RUNTIME_DIR, /run/cm, or $XDG_RUNTIME_DIR/cm)",
    )
    choice.add_argument(
        "--connect",
        type=parsed("an endpoint, such as tcp://kria.local", str, bool),
        metavar="ENDPOINT",
        help="a manager on another machine, such as tcp://kria.local (default: $CM_CONNECT)",
    )
    group.add_argument(
        "--keys", type=Path, metavar="FILE", help="this client's key file, for TCP with keys (default: $CM_KEYS)"
    )


def add_json_option(parser: argparse.ArgumentParser, run: Run) -> None:
    """Complete a command with ``--json``, output and errors for scripts, and what runs it."""
    parser.add_argument("--json", action="store_true", help="print JSON, errors included")
    parser.set_defaults(run=run)


def own_lease() -> str:
    """The id of the user's own lease, under which a command may touch what is held: $CM_LEASE, which ps(1) hides."""
    return os.environ.get("CM_LEASE", "")


def add_board_options(parser: argparse.ArgumentParser, run: Run) -> None:
    """Complete a command that asks a manager: which manager, ``--json``, and what runs it."""
    add_connection_options(parser)
    add_json_option(parser, run)


def parsed(what: str, read: Callable[[str], _T], accepts: Callable[[_T], bool] = lambda _: True) -> Callable[[str], _T]:
    """For argparse: a value that `read` makes of a word and `accepts` is true of; `what` stands in the error else."""

    def value_of(text: str) -> _T:
        with suppress(ValueError):
            value = read(text)
            if accepts(value):
                return value
        raise argparse.ArgumentTypeError(f"{text!r} is not {what}")

    return value_of


def number(text: str) -> int:
    """An integer as people write them: 2, 0x1f, 0b101. Raises ValueError."""
    return int(text, 0)


def extents(text: str) -> tuple[int, ...]:
    """A shape as people write them: 480x640. Raises ValueError."""
    return tuple(int(extent) for extent in text.lower().replace(",", "x").split("x"))


def digits(text: str) -> int:
    """A number of decimal digits; -1 for any other text."""
    return int(text) if text.isascii() and text.isdecimal() else -1


natural = parsed("a whole number, 0 or more", digits, lambda value: value >= 0)
positive = parsed("a whole number, 1 or more", digits, lambda value: value > 0)
slashed = parsed("a name, or CONFIG/MODE", str, lambda text: all(text.split("/")))  # not "", as of an unset variable
seconds = parsed("a time in seconds", float, lambda value: 0 <= value < 1e9)


def interval(text: str) -> float:
    """A time in seconds of more than 0; for argparse."""
    value = seconds(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r}: a time of more than 0 is wanted")
    return value


def answer(args: argparse.Namespace, value: Any, text: str, lines: bool = False) -> int:
    """Print `value` with ``--json``, else `text`, at once if it is one of several `lines`; the exit status, 0."""
    if args.json:
        print_json(value, lines)
    else:
        print(text, flush=lines)
    return 0


def answer_table(args: argparse.Namespace, value: Any, rows: Iterable[Sequence[object]], headers: Sequence[str]) -> int:
    """Print `value` with ``--json``, else a table (`print_table`); the exit status, 0."""
    if args.json:
        print_json(value)
    else:
        print_table(rows, headers)
    return 0


def print_json(value: Any, lines: bool = False) -> None:
    """Print `value` as JSON; with `lines` on one line, for continuing output (JSON Lines)."""
    text = json.dumps(value, default=_plain, ensure_ascii=False, indent=None if lines else 2)
    print(text, flush=lines)


def _plain(value: object) -> Any:
    """Values that JSON does not know: mappings that are not a dict, and paths."""
    if hasattr(value, "keys") and hasattr(value, "__getitem__"):
        return {key: value[key] for key in value.keys()}  # noqa: SIM118 - a mapping proxy, or the like
    return str(value)


@contextmanager
def naming(file: Path | str) -> Iterator[None]:
    """Name `file` in an error of the system that names none, such as a full disk's."""
    try:
        yield
    except OSError as error:
        raise named(error, file) from None


def named(error: OSError, file: Path | str) -> OSError:
    """The same error, about `file` if it names none; one of ours says enough."""
    if error.filename is None and not isinstance(error, CmError):
        error.filename = str(file)
    return error


def is_no_file(path: Path) -> bool:
    """Whether a device or a pipe is there, or a folder."""
    return path.exists() and not path.is_file()


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all: until then, what it held before stays. Devices and pipes take what comes."""
    if is_no_file(path):
        with naming(path):
            path.write_bytes(data)
        return
    import shutil  # only those who write a file need it

    target = path.resolve()
    aside = target.with_name(f".{target.name}.new")
    try:
        aside.write_bytes(data)
        if target.exists():
            shutil.copymode(target, aside)
        aside.replace(target)
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise
    finally:
        with suppress(OSError):
            aside.unlink()


def binary_output() -> IO[bytes]:
    """Standard output for bytes. Raises InvalidRequest if it is a terminal."""
    if sys.stdout.isatty():
        raise InvalidRequest("bytes are not written to a terminal: name a file, or send them on with > or |")
    return sys.stdout.buffer


def print_table(
    rows: Iterable[Sequence[object]], headers: Sequence[str], colours: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Print `rows` in columns under `headers`; numbers stand right, the last column is not padded.

    `colours`: of words in the last column, on a terminal that has colours.
    """
    cells = [["" if cell is None else _harmless(str(cell)) for cell in row] for row in rows]
    numeric = [bool(cells) and all(_is_number(row[index]) for row in cells) for index in range(len(headers))]
    widths = [max(len(row[index]) for row in [list(headers), *cells]) for index in range(len(headers))]
    for row in [list(headers), *cells]:
        columns = zip(row, widths, numeric, strict=True)
        line = [cell.rjust(width) if right else cell.ljust(width) for cell, width, right in columns]
        if row and row[-1] in colours:
            line[-1] = painted(row[-1], colours[row[-1]], sys.stdout)
        print("  ".join(line).rstrip())


def _harmless(text: str) -> str:
    """Names that others chose, without control characters for the terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).lstrip("-").isdigit()


def run_until_told(work: Callable[[], Coroutine[Any, Any, None]]) -> int:
    """Run `work` in an event loop until SIGINT or SIGTERM; the exit status, 0."""
    import asyncio
    import signal

    async def serve() -> None:
        task = asyncio.current_task()
        assert task is not None
        for each in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(each, task.cancel)
        await work()

    with suppress(asyncio.CancelledError):
        asyncio.run(serve())
    return 0

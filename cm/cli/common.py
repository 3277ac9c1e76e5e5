# SPDX-License-Identifier: Apache-2.0
"""What commands share: options, and output for people and for scripts."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO


def completes(argument: argparse.Action, *words: str) -> None:
    """Have the completion scripts offer `words`, and what runs for ``<KIND>`` (`cm.cli.completion.running`)."""
    argument.completes = words  # type: ignore[attr-defined]


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
    choice.add_argument("--connect", metavar="ENDPOINT", help="a manager elsewhere, such as tcp://kria.local")
    group.add_argument("--keys", type=Path, metavar="FILE", help="this client's key file, for TCP with keys")


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``: output for scripts; errors too are JSON then."""
    parser.add_argument("--json", action="store_true", help="print JSON, errors included")


def print_json(value: Any, lines: bool = False) -> None:
    """Print `value` as JSON; with `lines` on one line, for output that goes on (JSON Lines)."""
    text = json.dumps(value, default=_plain, ensure_ascii=False, indent=None if lines else 2)
    print(text, flush=lines)


def _plain(value: object) -> Any:
    """What JSON has no word for: mappings that are no dict, and paths."""
    if hasattr(value, "keys") and hasattr(value, "__getitem__"):
        return {key: value[key] for key in value.keys()}  # noqa: SIM118 - a mapping proxy, or the like
    return str(value)


def print_table(rows: Iterable[Sequence[object]], headers: Sequence[str]) -> None:
    """Print `rows` in columns under `headers`; numbers stand right, the last column is not padded."""
    cells = [["" if cell is None else str(cell) for cell in row] for row in rows]
    numeric = [bool(cells) and all(_is_number(row[index]) for row in cells) for index in range(len(headers))]
    widths = [max(len(row[index]) for row in [list(headers), *cells]) for index in range(len(headers))]
    for row in [list(headers), *cells]:
        columns = zip(row, widths, numeric, strict=True)
        print("  ".join(cell.rjust(width) if right else cell.ljust(width) for cell, width, right in columns).rstrip())


def _is_number(text: str) -> bool:
    return text.replace(".", "", 1).lstrip("-").isdigit()


class Progress:
    """A progress bar on stderr, drawn only where that is a terminal; a context manager.

    with Progress("loading") as progress:
        handle.wait(progress=progress.update)
    """

    def __init__(self, label: str, stream: TextIO | None = None) -> None:
        self._label = label
        self._stream = sys.stderr if stream is None else stream
        self._visible = self._stream.isatty()
        self._drawn = ""

    def update(self, fraction: float, note: str = "") -> None:
        """Show `fraction` (0 to 1; what lies outside is clipped) and a word about what goes on."""
        if not self._visible:
            return
        import shutil  # half a MiB, needed only for a progress bar

        line = bar(self._label, fraction, note, shutil.get_terminal_size().columns - 1)
        if line != self._drawn:
            self._stream.write("\r" + line.ljust(len(self._drawn)))
            self._stream.flush()
            self._drawn = line

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._drawn:  # leave the line clean for what comes next
            self._stream.write("\r" + " " * len(self._drawn) + "\r")
            self._stream.flush()


def bar(label: str, fraction: float, note: str, columns: int) -> str:
    """One line such as ``loading [#####     ]  50 % prr0``, at most `columns` wide."""
    fraction = min(max(fraction, 0.0), 1.0)
    tail = f" {round(100 * fraction):3d} %" + (f" {note}" if note else "")
    width = min(40, columns - len(label) - len(tail) - 3)
    if width < 5:
        return (label + tail)[:columns]
    done = round(width * fraction)
    return f"{label} [{'#' * done}{' ' * (width - done)}]{tail}"

# SPDX-License-Identifier: Apache-2.0
"""Finds the command and runs it; `cm.cli.failures` tells what went wrong."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from typing import TextIO

from cm.cli.commands import understood
from cm.cli.failures import EXIT_INTERRUPTED, EXIT_PIPE, EXIT_USAGE, failed, not_installed
from cm.cli.parser import build_parser, chosen_command, refuse_unknown
from cm.errors import CmError

# zenoh's threads may still call Python after its session was closed, and abort a process that is shutting Python down
_AT_ONCE = ("bridge", "fleet")


def run(arguments: Sequence[str] | None = None) -> int:
    """Run `cm` with `arguments` (default: those of the process); the exit status.

    Wrong usage ends in SystemExit(2), as argparse has it.
    """
    if arguments is None and "_ARGCOMPLETE" in os.environ:  # Tab was pressed
        from cm.cli.completion import answer

        return answer()
    if arguments is None:
        _open_closed()
    words = list(sys.argv[1:] if arguments is None else arguments)
    status = _ended(words)
    if arguments is None and _ends_at_once(words):
        os._exit(status)
    return status


def _open_closed() -> None:
    """Open what the shell has closed, at nothing: Python has no object for it, and its number is the next file's."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115, PTH123 (until the end)


def _ends_at_once(words: list[str]) -> bool:
    """Whether the process ends without taking Python apart: for `serve`, that takes longer than the rest of its end."""
    command = chosen_command(words)
    return command == "serve" or ("zenoh" in sys.modules and command in _AT_ONCE)


def _ended(words: list[str]) -> int:
    """Run; the exit status, when all output has been written."""
    _print_anything()
    try:
        try:
            return _outcome(words, "--json" in words)
        finally:
            _finish_errors()
            if sys.stdout is not None:  # as it is if the shell has closed it
                sys.stdout.flush()  # a reader that is gone, or a full disk, shows here, not at the interpreter's end
    except BrokenPipeError:
        _drop(sys.stdout)
        return EXIT_PIPE
    except OSError as error:
        _drop(sys.stdout)
        return failed(error, as_json=False, place="standard output: ")


def _outcome(words: list[str], as_json: bool) -> int:
    """Run; the exit status, where errors have been told."""
    try:
        return _run(words)
    except CmError as error:
        return failed(error, as_json)
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith("cm."):
            raise
        return not_installed(error.name, as_json)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        raise
    except OSError as error:
        return failed(error, as_json)


def _print_anything() -> None:
    """On a terminal that cannot show a character print a question mark for it, rather than end in an exception."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # stderr is lenient already
        sys.stdout.reconfigure(errors="replace")


def _run(words: list[str]) -> int:
    words = understood(words)
    chosen = chosen_command(words)
    if chosen is None:
        return _run_without(build_parser(None), words)
    refuse_unknown(build_parser(None), chosen)
    args = build_parser(chosen).parse_args(words)
    status: int = args.run(args)
    return status


def _run_without(parser: argparse.ArgumentParser, words: list[str]) -> int:
    parser.parse_args(words)  # --help and --version end here
    parser.print_help(sys.stderr)
    return EXIT_USAGE


def _finish_errors() -> None:
    """A log on a full disk is lost, and is no failure of the command (Python 3.13 would end with status 120)."""
    if sys.stderr is not None:
        try:
            sys.stderr.flush()
        except OSError:
            _drop(sys.stderr)


def _drop(output: TextIO) -> None:
    """Discard what is still buffered, so that the interpreter does not complain about it at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, output.fileno())
    os.close(nowhere)

# SPDX-License-Identifier: Apache-2.0
"""Finds the command, runs it, and turns errors into a sentence and an exit status.

Exit status: 0 done, 1 refused or failed, 2 wrong usage; 130 after Ctrl-C and 141 when the reader of
our output went away, as shells report a program that these signals ended.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Sequence
from typing import TextIO

from cm.cli.colours import as_told, colours_of
from cm.cli.commands import EXIT_INTERRUPTED, understood
from cm.cli.parser import build_parser, chosen_command, refuse_unknown
from cm.errors import CmError

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_PIPE = 141
# zenoh's threads may still call Python after its session was closed, and abort a process that is shutting Python down
_AT_ONCE = ("bridge", "fleet")
_PACKAGES = {"data": "sim", "simulation": "sim", "design": "build", "networks": "bridge", "tools.demo": "sim"}


def run(arguments: Sequence[str] | None = None) -> int:
    """Run `cm` with `arguments` (default: those of the process); the exit status.

    Wrong usage ends in SystemExit(2), as argparse has it.
    """
    if arguments is None and "_ARGCOMPLETE" in os.environ:  # Tab was pressed
        from cm.cli.completion import answer

        return answer()
    if arguments is None:
        _open_closed()
    words, colours = colours_of(list(sys.argv[1:] if arguments is None else arguments))
    with as_told(colours):
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
        return _failed(error, as_json=False, place="standard output: ")


def _outcome(words: list[str], as_json: bool) -> int:
    """Run; the exit status, where errors have been told."""
    try:
        return _run(words)
    except CmError as error:
        return _failed(error, as_json)
    except ModuleNotFoundError as error:
        part = (error.name or "").split(".")
        if part[0] != "cm" or len(part) < 2:
            raise
        absent = ".".join(part[1:3]) if part[1] == "tools" else part[1]
        return _fail("not_installed", _absent(absent), as_json)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        raise
    except OSError as error:
        return _failed(error, as_json)


def _absent(part: str) -> str:
    """The error for a missing part: distributions split the package, and say which of their packages has it."""
    name = _PACKAGES.get(part, part.removeprefix("tools."))
    return f"cm.{part} is not installed here: on Debian it is in fpga-cm-{name}, on Yocto in python3-fpga-cm-{name}"


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


def _failed(error: CmError | OSError, as_json: bool, place: str = "") -> int:
    from cm.cli.failures import code_and_sentence

    code, sentence = code_and_sentence(error)
    return _fail(code, f"{place}{sentence}", as_json)


def _fail(code: str, message: str, as_json: bool) -> int:
    """Say what went wrong: to people on stderr, to scripts on stdout."""
    if as_json:
        from cm.cli.common import print_json

        print_json({"error": {"code": code, "message": message}})
    else:
        from cm.cli.failures import tell

        tell(code, message)
    return EXIT_FAILED


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

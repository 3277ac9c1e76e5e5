# SPDX-License-Identifier: Apache-2.0
"""The command line: build, test, selfcheck, shell."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from vmboard import session
from vmboard.cache import Cache, default_root
from vmboard.errors import EXIT_MISSING, MissingError, VmError
from vmboard.progress import say
from vmboard.tiers import TIERS


def main(arguments: list[str] | None = None) -> int:
    """Exit status: 0 all good, 1 failed, 2 usage, 77 the host lacks something."""
    chosen = _parser().parse_args(arguments)
    try:
        return int(chosen.run(chosen))
    except MissingError as missing:
        say(f"SKIPPED: {missing}")
        return EXIT_MISSING
    except VmError as error:
        say(f"FAILED: {error}")
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="tests/vm/run", description=__doc__)
    parser.add_argument("--cache", type=Path, default=None, help="default: $CM_VM_CACHE, or cm-vm in the user's cache")
    commands = parser.add_subparsers(required=True)
    for name, run, text in (
        ("build", _build, "build everything, boot nothing"),
        ("test", _test, "run the tests"),
    ):
        command = commands.add_parser(name, help=text)
        tiers = "default: those that run each time, and those of which something has changed since they were good"
        command.add_argument("--tier", action="append", choices=["all", *TIERS], help=tiers)
        command.add_argument("--jobs", type=int, default=2, help="boards at a time (2)")
        command.add_argument("--output", type=Path, default=None, help="folder for logs and JUnit files")
        command.add_argument("-k", dest="keyword", default="", help="only tests that match, as pytest's -k")
        command.set_defaults(run=run)
    check = commands.add_parser("selfcheck", help="let kernels misbehave and see that it is noticed")
    check.set_defaults(run=_selfcheck)
    shell = commands.add_parser("shell", help="a shell on the board, the CM running, its ports forwarded")
    shell.add_argument("--tier", choices=list(TIERS), default="custom")
    shell.add_argument("--port", type=int, default=5560, help="first of the three ports on this host (5560)")
    shell.set_defaults(run=_shell)
    return parser


def _cache(chosen: argparse.Namespace) -> Cache:
    return Cache((chosen.cache or default_root()).resolve())


def _tiers(cache: Cache, chosen: argparse.Namespace) -> list[str]:
    named = chosen.tier or []
    return session.worth_while(cache, everything=True) if "all" in named else named or session.worth_while(cache)


def _build(chosen: argparse.Namespace) -> int:
    cache = _cache(chosen)
    session.build(cache, _tiers(cache, chosen))
    return 0


def _test(chosen: argparse.Namespace) -> int:
    cache = _cache(chosen)
    output = (chosen.output or cache.root / "last-run").resolve()
    return session.test(cache, _tiers(cache, chosen), output, chosen.jobs, chosen.keyword)


def _selfcheck(chosen: argparse.Namespace) -> int:
    cache = _cache(chosen)
    return session.selfcheck(cache, cache.root / "last-selfcheck")


def _shell(chosen: argparse.Namespace) -> int:
    return session.shell(_cache(chosen), chosen.tier, chosen.port)


if __name__ == "__main__":
    sys.exit(main())

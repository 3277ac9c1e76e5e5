# SPDX-License-Identifier: Apache-2.0
"""``cm conformance``: whether a client conforms to the wire protocol."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from cm.cli.common import add_json_option, print_json
from cm.errors import InvalidRequest, NotFound

if TYPE_CHECKING:
    from cm.tools.conformance.runner import Outcome


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Act as a manager towards a client in any language, case by case: DRIVER is a "
        "program, written by the client's author, that carries out commands given as "
        "lines of JSON (docs/conformance.md). Exit status 1 if a case failed."
    )
    parser.add_argument("--case", action="append", default=[], metavar="NAME", help="only these (default: all)")
    parser.add_argument("--list", action="store_true", help="list the cases, and what each is about")
    parser.add_argument("driver", nargs="*", metavar="DRIVER", help="the driver's command, after --")
    add_json_option(parser, run)


def run(args: argparse.Namespace) -> int:
    """Run the cases; the exit status."""
    if args.list:
        return _list(args.json)
    if not args.driver:
        raise InvalidRequest("say the command of a driver behind --")
    outcomes = []
    for outcome in _of_client(args):
        outcomes.append(outcome)
        if not args.json:
            print(f"{outcome.result:>8}  {outcome.name}: {outcome.why or outcome.says}", flush=True)
    failed = [o for o in outcomes if o.result == "failed"]
    if args.json:
        print_json([asdict(o) for o in outcomes])
    else:
        left = sum(o.result == "left out" for o in outcomes)
        print(f"{len(outcomes) - len(failed) - left} passed, {len(failed)} failed, {left} left out")
    return 1 if failed else 0


def _of_client(args: argparse.Namespace) -> Iterator[Outcome]:
    from cm.tools.conformance.client_cases import cases
    from cm.tools.conformance.runner import run as run_cases

    if shutil.which(args.driver[0]) is None:
        raise NotFound(f"no command {args.driver[0]!r}")
    known = list(cases())
    unknown = set(args.case) - {case.name for case in known}
    if unknown:
        raise NotFound(f"no case {', '.join(sorted(unknown))}; cm conformance --list has them")
    return run_cases(args.driver, (case for case in known if not args.case or case.name in args.case))


def _list(as_json: bool) -> int:
    from cm.tools.conformance.client_cases import cases

    known = [(case.name, case.says) for case in cases()]
    if as_json:
        print_json([{"name": name, "says": says} for name, says in known])
    else:
        for name, says in known:
            print(f"{name:16} {says}")
    return 0

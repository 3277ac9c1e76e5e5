# SPDX-License-Identifier: Apache-2.0
"""``cm bench``: measure latency and throughput beside the alternatives."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from cm.cli.common import positive, print_table
from cm.errors import InvalidRequest

if TYPE_CHECKING:
    from cm.tools.bench.catalogue import Case
    from cm.tools.bench.result import Result
    from cm.tools.bench.run import Run


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Measure fpga-cm and its alternatives side by side, in interleaved rounds on one "
        "CPU, on simulated boards. Exit status 0 if everything was measured or marked as "
        "not available, whatever the numbers are; 1 if something failed."
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="what to measure (default: all; --list names them)")
    parser.add_argument("--list", action="store_true", help="list what can be measured")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the results, with everything that describes the run"
    )
    parser.add_argument("--plots", type=Path, metavar="DIR", help="draw the figures as PNG (needs fpga-cm[bench])")
    parser.add_argument(
        "--compare",
        type=Path,
        metavar="DIR",
        help="this tree and another (a checkout with its .venv) in turns, instead",
    )
    parser.add_argument("--boards", type=positive, default=0, metavar="N", help="size of the fleet (50; --quick: 3)")
    parser.add_argument("--store", choices=("keeper", "etcd"), default="keeper", help="store of the fleet (keeper)")
    parser.add_argument(
        "--dir", type=Path, metavar="DIR", help="where everything lies that is measured (/tmp; a tmpfs: /dev/shm)"
    )
    parser.add_argument("--quick", action="store_true", help="measure little: shows that it works, not how fast it is")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure; the exit status."""
    from cm.tools.bench import catalogue, machine, plots, report

    if args.list:
        print("\n".join(catalogue.NAMES))
        return 0
    if args.compare:
        return _compare(args)
    cases = catalogue.chosen(args.names)
    if args.plots:
        plots.require()
    found = machine.describe()
    with tempfile.TemporaryDirectory(prefix="cmb", dir=args.dir or _short()) as folder, machine.pinned() as cpu:
        bench = _bench(args, Path(folder), cpu)
        found.update(pinned_to_cpu=cpu, quick=args.quick)
        results: list[Result] = []
        _say_what_is_missing(cases)
        try:
            for case in cases:
                results += _measure(case, bench, args.names)
                if args.json:  # so that results are kept if a later case is interrupted
                    report.write(args.json, results, {**found, "load_after": list(os.getloadavg())})
        finally:
            print_table(report.rows(results), report.HEADERS)
    if args.plots:
        plots.draw(args.plots, results)
    return int(any(result.missing.startswith(catalogue.FAILED) for result in results))


def _say_what_is_missing(cases: Sequence[Case]) -> None:
    """Before anything is measured, which takes minutes."""
    for case in cases:
        if why := case.missing():
            _tell(f"{case.module}: {why}")
        for package in case.missing_beside():
            _tell(f"{case.module} is measured without {package}, which is not installed")


def _tell(sentence: str) -> None:
    print(f"cm bench: {sentence}", file=sys.stderr, flush=True)


def _compare(args: argparse.Namespace) -> int:
    from cm.tools.bench import compare, machine, report

    if args.names or args.plots:
        raise InvalidRequest("--compare measures its own routes: it takes no NAME and no --plots")
    found = machine.describe()
    with machine.pinned() as cpu:
        pairs = list(compare.compare(args.compare, args.quick))
    if args.json:
        report.write(args.json, pairs, {**found, "pinned_to_cpu": cpu, "quick": args.quick})
    print_table([pair.row() for pair in pairs], compare.HEADERS)
    return 0


def _bench(args: argparse.Namespace, folder: Path, cpu: int | None) -> Run:
    from cm.tools.bench.run import Run

    cpus = frozenset(range(os.cpu_count() or 1))
    return Run(folder, args.quick, cpu, cpus, tuple(args.names), args.boards, args.store)


def _measure(case: Case, bench: Run, names: list[str]) -> list[Result]:
    from cm.tools.bench import catalogue

    _tell(f"{case.module} …")
    found = [result for result in catalogue.measure(case, bench) if not names or result.name in names]
    for result in found:
        _tell(f"{result.name}: {result.missing or f'{result.value:g} {result.unit}'}")
    return found


def _short() -> str | None:
    """A folder with a short name: sockets lie in it, whose paths have 107 bytes."""
    return "/tmp" if Path("/tmp").is_dir() else None

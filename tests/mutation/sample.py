# SPDX-License-Identifier: Apache-2.0
"""Whether the unit tests notice a defect: mutants of manager, server, bitstream and schema (`make mutation`).

    python tests/mutation/sample.py [PACKAGE…] [--count N] [--seed S] [--keep] [--max-survivors PERCENT]

mutmut makes every mutant it knows of these packages; this draws the same number from each package with a
fixed seed, has them tested, and prints those that lived, by package. A mutant of a function that no unit
test enters counts as one that lived. It works in `mutants/` (`--keep` goes on with what is there, and
`mutmut show NAME` says what a mutant changes). A package by itself gets the mutants that it gets among
the others. Exit status 1 with more survivors than allowed.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

PACKAGES = ("manager", "server", "formats.bitstream", "schema")  # below cm; all that `only_mutate` has can be named
MUTANTS = Path("mutants")
KILLED = {1, 3, 24, 36, 152, 255, -24, -9}  # failed, crashed, or out of time (`mutmut.stats`)
CHUNK = 200  # names on one command line


def mutmut(names: Iterable[str], jobs: int, log: Path) -> int:
    command = [sys.executable, "-m", "mutmut", "run", "--max-children", str(jobs), *names]
    with log.open("ab") as out:
        return subprocess.run(command, stdout=out, stderr=subprocess.STDOUT, check=False).returncode


def results() -> dict[str, int | None]:
    """Every mutant that was made, and the exit status of its tests."""
    found: dict[str, int | None] = {}
    for path in sorted(MUTANTS.rglob("*.py.meta")):
        found |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return found


def tested() -> set[str]:
    """Functions that a unit test enters, in mutmut's spelling."""
    stats = json.loads((MUTANTS / "mutmut-stats.json").read_text(encoding="utf-8"))
    return {name for name, tests in stats["tests_by_mangled_function_name"].items() if tests}


def draw(names: Iterable[str], packages: Iterable[str], share: int, seed: int) -> dict[str, list[str]]:
    """As many of each package, each with dice of its own: what is added to one changes no draw of another."""
    made = sorted(names)
    by_package = {package: [name for name in made if name.startswith(f"cm.{package}.")] for package in packages}
    return {
        package: sorted(random.Random(f"{seed} {package}").sample(of, min(share, len(of))))
        for package, of in by_package.items()
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", help=f"below cm; usually {', '.join(PACKAGES)}")
    parser.add_argument("--count", type=int, default=100, help="mutants of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--max-survivors", type=float, default=10.0, metavar="PERCENT")
    args = parser.parse_args()
    if not args.keep:
        shutil.rmtree(MUTANTS, ignore_errors=True)
    MUTANTS.mkdir(exist_ok=True)
    log = MUTANTS / "log.txt"
    # The name of no mutant: all are made, and the tests run once to see which enters which function.
    mutmut(["none"], args.jobs, log)
    if not (MUTANTS / "mutmut-stats.json").exists():
        print(f"the unit tests failed before anything was changed: {log}", file=sys.stderr)
        return 2
    drawn, entered = draw(results(), args.packages or PACKAGES, args.count, args.seed), tested()
    names = [name for of in drawn.values() for name in of if name.rpartition("__mutmut_")[0] in entered]
    for start in range(0, len(names), CHUNK):
        mutmut(names[start : start + CHUNK], args.jobs, log)
    return report(drawn, entered, args.max_survivors)


def report(drawn: dict[str, list[str]], entered: set[str], allowed: float) -> int:
    status, lived = results(), []
    for package, names in drawn.items():
        alive = [name for name in names if status[name] not in KILLED]
        lived += alive
        print(f"cm.{package}: {len(alive)} of {len(names)} mutants lived")
        for name in alive:
            print(f"    {name}{'' if name.rpartition('__mutmut_')[0] in entered else '  (no unit test enters it)'}")
    total = sum(map(len, drawn.values()))
    print(f"{len(lived)} of {total} lived: {100 * len(lived) / total:.1f} %")
    return 0 if 100 * len(lived) <= allowed * total else 1


if __name__ == "__main__":
    sys.exit(main())

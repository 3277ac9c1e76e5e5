# SPDX-License-Identifier: Apache-2.0
"""Whether the unit tests notice a defect: one change at a time in a package, and its tests (`make mutation`).

    python tests/mutation/sample.py [PACKAGE…] [--count N] [--seed S] [--jobs N] [--max-survivors PERCENT]

mutmut says which changes there are (in functions without decorators). This draws the same number from each package
with a fixed seed, writes each into a copy of the tree (`build/mutants/`), and runs the tests for that package
(`PACKAGES`) that enter the changed function, until one fails: in processes of their own, so that threads, caches and
what is computed while modules are loaded see the change too. Those that lived are printed, with what they change; one
in a function that none of them enters has lived. Exit status 1 with more survivors than allowed.
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import queue
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import coverage
import libcst
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.file_mutation import Mutation, create_mutations, deep_replace

_CORE = tuple(f"unit/{room}" for room in ("manager", "server", "formats", "schema", "wire", "client"))
# A board's client is best seen beside a manager, which is a process of its own there; no tests of other rooms enter it.
_WITH_MANAGER = (
    "allocations",
    "client_conformance",
    "connections",
    "field_access",
    "local_reads",
    "memories",
    "modes",
    "register_windows",
    "remote_streams",
    "stream_format",
    "stream_settings",
)
_CLIENT = ("unit/client", *(f"integration/test_{name}.py" for name in _WITH_MANAGER))
_DESIGN = ("hdl_", "boundary", "clock_", "build_check", "build_flat", "build_foreign", "build_reg", "build_sources")
# Packages below cm, and what of tests/ is tried. Any other can be named too; its tests are then in its unit tests.
PACKAGES = {
    **dict.fromkeys(("manager", "server", "formats.bitstream", "schema"), _CORE),
    "client": _CLIENT,
    **dict.fromkeys(("design.hdl", "design.boundary"), tuple(f"unit/design/test_{name}*" for name in _DESIGN)),
}
MUTANTS = Path("build/mutants")
NO_TESTS = 5  # pytest's status


@dataclass(frozen=True)
class Mutant:
    path: str
    number: int  # among those of this file
    module: libcst.Module
    mutation: Mutation
    lines: range  # of the changed function's body

    def code(self) -> str:
        changed = deep_replace(self.module, self.mutation.original_node, self.mutation.mutated_node)
        assert isinstance(changed, libcst.Module)
        return changed.code

    def __str__(self) -> str:
        before, after = self.module.code.splitlines(), self.code().splitlines()
        changes = list(difflib.unified_diff(before, after, n=0, lineterm=""))[2:]
        return "\n".join([f"    {self.path}", *("    " + line for line in changes)])


@dataclass(frozen=True)
class Entries:
    """What the tests of a package did before anything was changed."""

    tree: Path
    lines: coverage.CoverageData
    times: dict[str, float]  # by test

    def of(self, mutant: Mutant) -> list[str]:
        """Tests, or files of tests, that enter the changed function; all the package's own if it runs at import."""
        found = self.lines.contexts_by_lineno(str((self.tree / mutant.path).resolve()))
        entered = {test for line in mutant.lines for test in found.get(line, ())}
        own = f"tests/unit/{Path(mutant.path).parts[1]}/"
        loading = {file_of(test) for test in self.times if test.startswith(own)} if entered == {""} else set()
        return sorted(entered - {""} | loading)

    def seconds(self, tests: list[str], own: str) -> dict[str, float]:
        """The files of these tests, first the package's own, the fastest first, and what the tests take."""
        chosen, seconds = set(tests), dict.fromkeys(map(file_of, tests), 0.0)
        for test, time in self.times.items():
            if test in chosen or file_of(test) in chosen:
                seconds[file_of(test)] += time
        return dict(sorted(seconds.items(), key=lambda file: (not file[0].startswith(own), file[1])))


def file_of(test: str) -> str:
    return test.partition("::")[0]


def tracked(*options: str) -> list[str]:
    listed = subprocess.run(["git", "ls-files", "-z", *options], stdout=subprocess.PIPE, check=True)
    return [name for name in listed.stdout.decode().split("\0") if name and Path(name).is_file()]


def copy(tree: Path) -> Path:
    """The tree as it is now, with what is built in cm."""
    for name in tracked("-co", "--exclude-standard") + tracked("-oi", "--exclude-standard", "cm"):
        if not name.endswith(".pyc"):
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(name, tree / name, follow_symlinks=False)
    return tree


def mutants(path: str) -> Iterator[Mutant]:
    module, mutations, *_ = create_mutations(path, Path(path).read_text(encoding="utf-8"))
    positions = MetadataWrapper(module, unsafe_skip_copy=True).resolve(PositionProvider)
    for number, mutation in enumerate(mutations):
        if isinstance(function := mutation.contained_by_top_level_function, libcst.FunctionDef):
            body = function.body.body
            lines = range(positions[body[0]].start.line, positions[body[-1]].end.line + 1)
            yield Mutant(path, number, module, mutation, lines)


def draw(package: str, count: int, seed: int) -> list[Mutant]:
    """Each package with dice of its own: what is added to one changes no draw of another."""
    made = [mutant for path in sorted(tracked(f"cm/{package.replace('.', '/')}/*.py")) for mutant in mutants(path)]
    return random.Random(f"{seed} {package}").sample(made, min(count, len(made)))


def pytest(tree: Path, tests: list[str], limit: float | None, under: list[str], **given: str) -> int:
    """The status of a run in this tree; with a limit (seconds), that of a process that was killed."""
    command = [sys.executable, "-m", *under, "pytest", "-p", "tests.mutation.entries", "-p", "no:cacheprovider"]
    command += ["-xq", *tests]
    environment = os.environ | {"PYTHONPATH": str(tree.resolve())} | given
    with (tree / "pytest.log").open("ab") as log:
        run = subprocess.Popen(command, cwd=tree, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            return run.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            return run.wait()


@cache
def enter(tree: Path, patterns: tuple[str, ...]) -> Entries:
    """Run all tests of these patterns."""
    lines, times = tree / f"lines-{len(patterns)}", tree / "times"
    tests = sorted(str(path) for pattern in patterns for path in Path("tests").glob(pattern))
    under = ["coverage", "run", f"--data-file={lines.resolve()}", "--source=cm", "-m"]
    if pytest(tree, tests, None, under, CM_TEST_TIMES=str(times.resolve())):
        sys.exit(f"the unit tests failed before anything was changed: {tree / 'pytest.log'}")
    data = coverage.CoverageData(str(lines))
    data.read()
    return Entries(tree, data, json.loads(times.read_text(encoding="utf-8")))


def lives(mutant: Mutant, tree: Path, entries: Entries) -> bool:
    tests = entries.of(mutant)
    if not tests:
        return True
    chosen, changed = tree / "tests.json", tree / mutant.path
    seconds = entries.seconds(tests, f"tests/unit/{Path(mutant.path).parts[1]}/")
    chosen.write_text(json.dumps(tests), encoding="utf-8")
    original = changed.rename(changed.with_suffix(".original"))
    changed.write_text(mutant.code(), encoding="utf-8")
    os.utime(changed, (mutant.number, mutant.number))  # else byte code of another one, as long and as new, is taken
    try:
        limit = 60 + 10 * sum(seconds.values())
        status = pytest(tree, list(seconds), limit, [], CM_TESTS=str(chosen.resolve()))
    finally:
        original.replace(changed)
    assert status != NO_TESTS, f"no test of {tests} is there"
    return status == 0


def survivors(trees: queue.Queue[Path], drawn: list[Mutant], entries: Entries) -> list[Mutant]:
    def tried(mutant: Mutant) -> bool:
        tree = trees.get()
        try:
            return lives(mutant, tree, entries)
        finally:
            trees.put(tree)

    with ThreadPoolExecutor(trees.qsize()) as pool:
        return [mutant for mutant, alive in zip(drawn, pool.map(tried, drawn), strict=True) if alive]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", help=f"below cm; usually {', '.join(PACKAGES)}")
    parser.add_argument("--count", type=int, default=100, help="mutants of each package")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--max-survivors", type=float, default=10.0, metavar="PERCENT")
    args = parser.parse_args()
    shutil.rmtree(MUTANTS, ignore_errors=True)
    trees: queue.Queue[Path] = queue.Queue()
    for job in range(args.jobs):
        trees.put(copy(MUTANTS / str(job)))
    total = lived = 0
    for package in args.packages or PACKAGES:
        tests = PACKAGES.get(package, (f"unit/{package.partition('.')[0]}",))
        drawn, entries = draw(package, args.count, args.seed), enter(MUTANTS / "0", tests)
        alive = survivors(trees, drawn, entries)
        print(f"cm.{package}: {len(alive)} of {len(drawn)} mutants lived")
        for mutant in alive:
            print(mutant, *([] if entries.of(mutant) else ["    no test enters it"]), sep="\n", flush=True)
        total, lived = total + len(drawn), lived + len(alive)
    print(f"{lived} of {total} lived: {100 * lived / total:.1f} %")
    return 0 if 100 * lived <= args.max_survivors * total else 1


if __name__ == "__main__":
    sys.exit(main())

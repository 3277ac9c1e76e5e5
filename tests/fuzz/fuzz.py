# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of every reader of bytes from outside (`make fuzz`; needs atheris).

    python tests/fuzz/fuzz.py [TARGET…] [--minutes M] [--jobs N] [--seed S] [--keep]

Each target runs in a process of its own, from its seeds, the kept corpus and what earlier runs found in
`build/fuzz/<target>`. An input that takes 20 s of processor time or 2 GiB, or that raises what the target does not
expect, is a finding: it is left in `build/fuzz`, named at the end, and the exit status is 1. `--keep` adds what
reaches new code to the kept corpus, in the fewest files (`-merge=1`). `--seed` makes the same inputs in the same
order, from an empty `build/fuzz`: what a short run with it finds is the change's doing, not chance.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import importlib
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
CORPUS = HERE / "corpus"
WORK = HERE.parents[1] / "build" / "fuzz"
SECONDS, MIB = 20, 2048  # of one input; processor time: a machine that is busy finds nothing else
HUNG = 300  # seconds that pass, after which one is taken to go on for ever
KEPT = 1024  # bytes of a file in the kept corpus, at most


def names() -> list[str]:
    """Every target."""
    return sorted(path.stem for path in (HERE / "targets").glob("[a-z]*.py"))


class TooSlow(Exception):
    """An input that takes too much of a processor's time."""


def bounded(one: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """What reads one input, and is not to take long."""

    def timed(data: bytes) -> None:
        begun = time.process_time()
        one(data)
        if (took := time.process_time() - begun) > SECONDS:
            raise TooSlow(f"{took:.0f} s for {len(data)} bytes")

    return timed


def run_one(name: str, flags: list[str]) -> None:
    """Fuzz in this process, which ends with it."""
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is not installed: pip install 'fpga-cm[fuzz]' (Python 3.11 to 3.13 on x86-64)")
    # The packages have to be known before the target is imported: they stand in its first lines.
    packages = next(line for line in (HERE / "targets" / f"{name}.py").read_text().splitlines() if "PACKAGES =" in line)
    scope: dict[str, tuple[str, ...]] = {}
    exec(packages, scope)  # a literal of ours
    with atheris.instrument_imports(include=list(scope["PACKAGES"])):
        target = importlib.import_module(f"targets.{name}")
    found = WORK / name
    found.mkdir(parents=True, exist_ok=True)
    for index, seed in enumerate(target.seeds()):
        (found / f"seed{index}").write_bytes(seed)
    again = shlex.join([sys.executable, str(Path(__file__).resolve()), "--one", name])  # a merge starts itself anew
    atheris.Setup([again, f"-max_len={target.MAX_LENGTH}", *flags], bounded(target.one))
    atheris.Fuzz()


def _child(name: str, *flags: str) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, str(Path(__file__).resolve()), "--one", name, *flags]
    with (WORK / f"{name}.log").open("ab") as log:
        # The order of sets is part of what a seed repeats. Scratch folders lie in one of ours: a fuzzer ends by _exit.
        scratch = WORK / f"{name}.scratch"
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir()
        fixed = {**os.environ, "PYTHONHASHSEED": "0", "TMPDIR": str(scratch)}
        try:
            return subprocess.run(command, cwd=WORK, stdout=log, stderr=subprocess.STDOUT, check=False, env=fixed)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def fuzz(name: str, seconds: int, seed: int) -> str:
    """Fuzz in a child; what is to be said of it."""
    WORK.mkdir(parents=True, exist_ok=True)
    (WORK / f"{name}.log").unlink(missing_ok=True)
    kept = CORPUS / name
    started = time.monotonic()
    child = _child(
        name,
        f"-max_total_time={seconds}",
        f"-timeout={HUNG}",
        f"-rss_limit_mb={MIB}",
        f"-artifact_prefix={name}-",
        f"-seed={seed}",
        "-print_final_stats=1",
        str(WORK / name),
        *([str(kept)] if kept.is_dir() else []),
    )
    log = (WORK / f"{name}.log").read_text(errors="replace")
    runs = next((line.split()[-1] for line in log.splitlines() if "number_of_executed_units" in line), "0")
    if child.returncode:
        return f"FAILED {name}: {WORK / f'{name}.log'} (input: {WORK}/{name}-*)"
    if runs == "0":
        return f"FAILED {name}: not one input was run ({WORK / f'{name}.log'})"
    return f"{name}: {runs} inputs in {time.monotonic() - started:.0f} s"


def keep(name: str) -> None:
    """The kept corpus with what reaches code that it does not reach yet."""
    (CORPUS / name).mkdir(parents=True, exist_ok=True)
    _child(name, "-merge=1", f"-max_len={KEPT}", str(CORPUS / name), str(WORK / name))


def main() -> int:
    if sys.argv[1:2] == ["--one"]:
        run_one(sys.argv[2], sys.argv[3:])
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", choices=[*names(), []], help=", ".join(names()))
    parser.add_argument("--minutes", type=float, default=10.0, help="for each target")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the inputs' order; 0, the default: chance")
    parser.add_argument("--keep", action="store_true")
    args = parser.parse_args()
    wanted = args.targets or names()
    with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool:
        told = list(pool.map(lambda name: fuzz(name, max(1, round(60 * args.minutes)), args.seed), wanted))
    if args.keep:
        for name in wanted:
            keep(name)
    print("\n".join(told))
    return int(any(line.startswith("FAILED") for line in told))


if __name__ == "__main__":
    sys.exit(main())

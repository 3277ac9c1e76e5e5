# SPDX-License-Identifier: Apache-2.0
"""Two trees, measured in turns: this one, and another checkout with an environment of its own."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.errors import CmError, InvalidRequest

HEADERS = ("route and figure", "other", "this", "ratio", "spread")
SCRIPT = Path(__file__).with_name("routes.py")


@dataclass(frozen=True, slots=True)
class Pair:
    """One figure of both trees, by round: each is measured once in a round."""

    name: str
    other: tuple[float, ...]
    this: tuple[float, ...]

    @property
    def ratios(self) -> tuple[float, ...]:
        """This tree's figure divided by the other's, of each round; of nothing and nothing, 1."""
        return tuple(
            mine / theirs if theirs else 1.0 + mine for mine, theirs in zip(self.this, self.other, strict=True)
        )

    @property
    def ratio(self) -> float:
        """The median of the rounds'."""
        return statistics.median(self.ratios)

    def row(self) -> tuple[str, ...]:
        """As `cm bench --compare` prints it."""
        spread = f"{min(self.ratios):.3f} to {max(self.ratios):.3f}" if len(self.ratios) > 1 else ""
        values = (f"{statistics.median(values):.5g}" for values in (self.other, self.this))
        return (self.name, *values, f"{self.ratio:.3f}", spread)

    def plain(self) -> dict[str, Any]:
        """As it stands in the JSON file."""
        return {"other": self.other, "this": self.this, "ratio": self.ratio, "ratios": self.ratios}


def compare(other: Path, quick: bool) -> Iterable[Pair]:
    """Measure both trees, as kind after kind is done: times in turns, counts once. Raises CmError.

    `other`: a checkout whose environment is in `.venv`, or an environment. Instructions, which take minutes, are
    counted unless `quick`.
    """
    pythons = (_python(other), Path(sys.executable))
    for kind, rounds in (("times", 2 if quick else 7), ("counts", 1), ("instructions", 0 if quick else 1)):
        found: tuple[list[Mapping[str, float]], ...] = ([], [])
        for number in range(rounds):
            for which in (0, 1) if number % 2 == 0 else (1, 0):
                found[which].append(measured(pythons[which], kind, quick))
        names = [name for name in found[1][0] if name in found[0][0]] if rounds else []
        for name in names:
            yield Pair(name, *(tuple(one[name] for one in rounds_of) for rounds_of in found))


def _python(folder: Path) -> Path:
    for place in (folder / ".venv/bin/python", folder / "bin/python"):
        if place.exists():
            return place.absolute()
    raise InvalidRequest(f"{folder}: there is neither .venv/bin/python nor bin/python; make bench-compare makes a tree")


def measured(python: Path, kind: str, quick: bool = False) -> dict[str, float]:
    """What `routes.py` finds in the tree of this Python, whichever tree ours is. Raises CmError."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(python), str(SCRIPT), kind, *(["--quick"] if quick else [])]
    done = subprocess.run(words, cwd="/", env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CmError(
            f"{python} {SCRIPT.name} {kind} ended with status {done.returncode}: {done.stderr.strip()[-2000:]}"
        )
    found: dict[str, float] = json.loads(done.stdout)
    return found

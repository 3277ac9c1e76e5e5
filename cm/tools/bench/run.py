# SPDX-License-Identifier: Apache-2.0
"""What all measurements of a run share: how much to measure, where, and which baselines are available."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from cm.tools.bench.peer import Peer, Unavailable
from cm.tools.bench.rounds import Batch, Plan, timed

IMAGE = 4_147_200  # bytes of the paper's middle image: 1920 × 1080 × 2, 3.96 MiB
IMAGES = (8_294_400, IMAGE, 2_073_600)  # 7.91, 3.96 and 1.98 MiB


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the bench.

    `quick`: only as much as shows that everything works. `cpus` are the CPUs for cases that need more than one. `names`
    are the results that are wanted, all if there is none; `boards` and `store` are a fleet's.
    """

    folder: Path
    quick: bool = False
    cpu: int | None = None
    cpus: frozenset[int] = frozenset()
    names: tuple[str, ...] = ()
    boards: int = 0
    store: str = "keeper"

    @property
    def bytecode(self) -> Path:
        """Where bytecode of the run's processes is kept."""
        return self.folder / "bytecode"

    def plan(self, trips: int, rounds: int = 20, warm: int = 3) -> Plan:
        """How often to measure, for trips of which `trips` make a round."""
        return Plan(2, min(trips, 5), 1) if self.quick else Plan(rounds, trips, warm)

    def place(self, name: str) -> Path:
        """A folder for one use, with a short path (a socket's may have 107 bytes)."""
        number = sum(1 for _ in self.folder.iterdir())
        path = self.folder / f"{name}{number}"
        path.mkdir()
        return path


class Baselines:
    """The baselines of one measurement that are available here; `missing` says why the others are not."""

    def __init__(self, run: Run, stack: ExitStack) -> None:
        self._run = run
        self._stack = stack
        self.batches: dict[str, Batch] = {}
        self.missing: dict[str, str] = {}

    def add(self, kinds: Iterable[str], size: int) -> None:
        """Start these kinds of peers with messages of `size` bytes."""
        for kind in kinds:
            try:
                peer = self._stack.enter_context(Peer(kind, self._run.place(kind), size))
            except Unavailable as why:
                self.missing[kind] = str(why)
            else:
                self.batches[kind] = timed(peer.trip)

# SPDX-License-Identifier: Apache-2.0
"""Places and routes the static part and the modules, beginning with one seed of the static part."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from cm.design.errors import BuildError, StepFailed
from cm.design.openflow.job import Job, elsewhere, labels, module_job, pins_xdc, static_job, with_cells, without
from cm.design.openflow.layout import Layout
from cm.design.openflow.merge import CLOCK, Side, left_out, module_features, static_features, strays
from cm.design.openflow.place_and_route import SCRIPTS, Files, cells_of, place_and_route, read_side, slacks, timing
from cm.design.openflow.steps import OpenStepEndless, Steps, Tell, key_of
from cm.design.openflow.tools import Tools
from cm.design.plan.pins import placements
from cm.design.plan.system import Implementation, System
from cm.formats.xray import Database, Feature, Wires

Judge = Callable[[], list[str]]
Features = frozenset[Feature]
Run = Future[Features]
_ROUTING = re.compile(r"ERROR: .*\brout(e|ing|able)\b", re.IGNORECASE)


_TOO_NARROW = "give its region more columns, or the module less logic"


class Unroutable(StepFailed):
    """A module could not be routed with any seed; it may be possible against another static part."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a run: first seed, how many seeds to try, programs at once, static parts to try."""

    seed: int = 1
    tries: int = 4
    jobs: int = 2
    statics: int = 3


@dataclass(frozen=True)
class Context:
    """What all attempts share; `netlists`: the folder of yosys' results; `failed`: keys that cannot be placed."""

    system: System
    database: Database
    wires: Wires
    layouts: dict[str, Layout]
    tools: Tools
    settings: Settings
    tell: Tell
    netlists: Path
    rate: float
    failed: set[str] = field(default_factory=set)


class Attempt:
    """One static part, and the modules against it."""

    def __init__(self, context: Context, number: int, ran: list[str]) -> None:
        """`number` counts static parts from 0; the files of number 0 lie beside the netlists."""
        self._context, self._settings = context, context.settings
        self.seed = context.settings.seed + number * context.settings.tries
        self._folder = context.netlists / f"seed_{self.seed}" if number else context.netlists
        self._folder.mkdir(exist_ok=True)
        self._steps = Steps(self._folder, context.tell, ran)

    def run(self) -> tuple[Features, dict[str, Features]]:
        """Return features of the static part, and of modules by name. Raises Unroutable, StepFailed, BuildError."""
        one = self._context
        static = self._static()
        features = static_features(one.database, one.layouts.values(), static)
        buffer = static.routed.place(CLOCK)
        jobs = {
            name: module_job(one.database, one.wires, layout, static.routed, features, buffer)
            for name, layout in one.layouts.items()
        }
        _complete("the static part", left_out(one.database, static, features, one.database.tiles))
        with ThreadPoolExecutor(self._settings.jobs) as pool:
            every = one.system.placed
            moved = {each.name: self._taken_elsewhere(each, static) for each in every if each.module.relocatable}
            runs = {
                each.name: pool.submit(
                    self._module, each, without(jobs[each.region.name], moved.get(each.name, set())), features
                )
                for each in every
            }
        return features, {name: run.result() for name, run in _hopeless_first(runs)}

    def _taken_elsewhere(self, each: Implementation, static: Side) -> set[str]:
        one = self._context
        own = one.layouts[each.region.name]
        others = [layout for layout in one.layouts.values() if layout is not own]
        return elsewhere(one.database, one.wires, own, others, static.routed)

    def _files(self, name: str) -> Files:
        source = self._context.netlists / f"{name}.json"
        files = Files(self._folder, name)
        if self._folder != self._context.netlists:
            shutil.copyfile(source, files.file("json"))
        return files

    def _static(self) -> Side:
        one = self._context
        inputs = labels(one.layouts.values())[True]
        job = static_job(one.database, list(one.layouts.values()))
        files = self._files("static")
        xdc = pins_xdc(placements(one.system)[0])

        def judge() -> list[str]:
            read, told = (
                timing(files),
                read_side(one.database, files, inputs, static=True).routed.lost()[:3],
            )
            return told if read.inside <= 1e9 / one.rate else [*told, f"its longest path takes {read.inside:.2f} ns"]

        try:
            self._placed(files, job, xdc, judge, "the static part")
        except Unroutable as problem:  # with another seed it would be another static part
            raise StepFailed(str(problem)) from None
        return read_side(one.database, files, inputs, static=True)

    def _module(self, module: Implementation, job: Job, features: Features) -> Features:
        one = self._context
        layout = one.layouts[module.region.name]
        inputs = labels([layout])[False]
        files = self._files(module.name)
        static = Files(self._folder, "static")

        def judge() -> list[str]:
            side = read_side(one.database, files, inputs, static=False)
            told = [*side.routed.lost(), *strays(one.database, layout, side, features)]
            left = slacks(timing(static), timing(files), 1e9 / one.rate)
            return told[:3] + [f"{what}: {-value:.2f} ns too long" for what, value in left.items() if value < 0]

        self._placed(files, job, "", judge, f"module {module.name}")
        side = read_side(one.database, files, inputs, static=False)
        found = module_features(one.database, layout, side)
        _complete(f"module {module.name}", left_out(one.database, side, features | found, layout.tiles))
        return found

    def _placed(self, files: Files, job: Job, xdc: str, judge: Judge, what: str) -> None:
        """Place and route with one seed after another, until the result passes all checks."""
        one, part = self._context, self._context.system.project.part
        job = with_cells(job, cells_of(files), one.database, what)
        key = key_of(job, xdc, one.rate, self.seed, one.tools.versions, files.file("json"), *SCRIPTS)
        if key in one.failed:
            raise Unroutable(f"{what} could not be routed before")

        def work() -> None:
            wrong, elsewhere = [], False
            for seed in range(self.seed, self.seed + self._settings.tries):
                try:
                    place_and_route(one.tools.nextpnr, part, files, job, xdc, one.rate / 1e6, seed)
                    told = judge()
                    elsewhere |= bool(told)
                except OpenStepEndless as problem:
                    raise StepFailed(f"{what}: {problem}; {_TOO_NARROW}") from None
                except StepFailed as problem:
                    told = [str(problem)]
                    elsewhere |= bool(_ROUTING.search(told[0]))
                if not told:
                    return
                wrong += [f"seed {seed}: {sentence}" for sentence in told]
                if seed + 1 < self.seed + self._settings.tries:
                    one.tell(f"{files.name}: another seed, because of {told[0].splitlines()[-1].strip()}")
            text = f"{what} could not be placed and routed:\n  " + "\n  ".join(wrong)
            if not elsewhere:
                raise StepFailed(text)
            one.failed.add(key)
            raise Unroutable(text)

        title = f"place and route of {what} by nextpnr, from seed {self.seed}"
        self._steps.step(f"place_{files.name}", title, key, files.outputs, work)


def _hopeless_first(runs: dict[str, Run]) -> list[tuple[str, Run]]:
    """Order runs so that a failure that another static part would not cure is reported first."""
    return sorted(runs.items(), key=lambda run: isinstance(run[1].exception() or Unroutable(), Unroutable))


def _complete(what: str, missing: Iterable[str]) -> None:
    for sentence in missing:
        raise BuildError(f"{what}: {sentence}")

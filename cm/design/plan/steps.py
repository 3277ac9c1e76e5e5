# SPDX-License-Identifier: Apache-2.0
"""The steps of the vendor's flow: the inputs, prerequisites and outputs of each."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass

from cm.design.plan.system import Implementation, System


@dataclass(frozen=True, slots=True)
class Step:
    """One call of Vivado with ``tcl/step_<name>.tcl``."""

    name: str
    title: str
    after: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Run:
    """An implementation run: a checkpoint for each cell, and the regions that stay empty."""

    name: str
    number: int
    modules: dict[str, str]  # region → implementation
    cells: tuple[tuple[str, str], ...]
    greybox: tuple[str, ...]
    partials: tuple[Implementation, ...]  # whose bitstreams this run is the first to make

    @property
    def doc(self) -> str:
        """The modules, for messages."""
        return ", ".join(f"{region}: {module}" for region, module in self.modules.items())


def runs(system: System) -> tuple[Run, ...]:
    """The implementation runs; the first fixes the static part."""
    written: set[str] = set()
    found = []
    for number, modules in enumerate(system.runs, 1):
        cells = tuple(
            (region.cell, f"checkpoints/synth_{modules[region.name]}.dcp")
            for region in system.regions
            if region.name in modules
        )
        greybox = tuple(region.cell for region in system.regions if region.name not in modules)
        chosen = {(region, name) for region, name in modules.items()}
        fresh = [i for i in system.implementations if (i.region.name, i.name) in chosen and i.name not in written]
        written |= {i.name for i in fresh}
        found.append(Run(f"run_{number}", number, dict(modules), cells, greybox, tuple(fresh)))
    return tuple(found)


def shelled(system: System) -> tuple[Implementation, ...]:
    """The modules that are placed and routed in abstract shells: those not in the first run."""
    if not system.project.static.abstract_shells:
        return ()
    first = set(runs(system)[0].modules.items())
    return tuple(one for one in system.implementations if (one.region.name, one.name) not in first)


def needed(steps: tuple[Step, ...], wanted: Iterable[str]) -> set[str]:
    """Names of the wanted steps and of all their prerequisites."""
    by_name, found = {step.name: step for step in steps}, set[str]()
    left = list(wanted)
    while left:
        name = left.pop()
        if name not in found:
            found.add(name)
            left.extend(by_name[name].after)
    return found


def ends(steps: Sequence[Step]) -> list[Step]:
    """The steps that no other one needs."""
    before = {name for step in steps for name in step.after}
    return [step for step in steps if step.name not in before]


def steps_json(steps: Iterable[Step]) -> str:
    """The steps as ``steps.json`` has them, which `cm.design.run.flow.Flow` reads."""
    return json.dumps({"version": 1, "steps": [asdict(step) for step in steps]}, indent=2)


def steps(system: System) -> tuple[Step, ...]:
    """All steps, each after its prerequisites."""
    planned = runs(system)
    found = [
        Step("system", "block design", (), ()),
        Step("static", "synthesis of the static part", ("system",), ("checkpoints/static_synth.dcp",)),
    ]
    for one in system.implementations:
        title = f"synthesis of {one.module.name} for {one.region.name}"
        found.append(Step(f"synth_{one.name}", title, (), (f"checkpoints/synth_{one.name}.dcp",)))
    for run in planned:
        needs = tuple(f"synth_{name}" for name in dict.fromkeys(run.modules.values()))
        before = "static" if run.number == 1 else planned[0].name
        outputs = [f"checkpoints/{run.name}.dcp"] + ["checkpoints/static_routed.dcp"] * (run.number == 1)
        found.append(Step(run.name, f"place and route: {run.doc}", (before, *needs), tuple(outputs)))
    found.append(Step("verify", "comparison of all runs", tuple(run.name for run in planned), ()))
    for run in planned:
        names = [one.name for one in run.partials] + [system.full] * (run.number == 1)
        outputs = [f"bitstreams/{one.name}.{kind}" for one in run.partials for kind in ("bit", "bin")]
        outputs += [f"bitstreams/{system.full}.bit"] * (run.number == 1)
        title = f"bitstreams of {', '.join(names) or 'nothing new'}"
        found.append(Step(f"bitstreams_{run.name}", title, ("verify", run.name), tuple(outputs)))
    if system.project.static.abstract_shells:
        found += _shell_steps(system, planned[0].name)
    return tuple(found)


def _shell_steps(system: System, first: str) -> Iterator[Step]:
    """Steps that make a shell of each region, then the bitstream of each module in its region's shell."""
    for region in system.regions:
        outputs = tuple(f"checkpoints/shell_{region.name}.{kind}" for kind in ("dcp", "id"))
        yield Step(f"shell_{region.name}", f"abstract shell of {region.name}", (first,), outputs)
    for one in shelled(system):
        outputs = (f"checkpoints/module_{one.name}.dcp", *(f"bitstreams/{one.name}.{kind}" for kind in ("bit", "bin")))
        title = f"{one.module.name} in the abstract shell of {one.region.name}"
        yield Step(f"module_{one.name}", title, (f"shell_{one.region.name}", f"synth_{one.name}"), outputs)


def clashes(system: System) -> Iterator[tuple[str, list[str]]]:
    """Files that several products of the flow would be written to, each with what they are."""
    products = [(f"{system.full}.bit", "the bitstream of the whole device")]
    for one in system.implementations:
        products.append((f"{one.name}.bit", f"the bitstream of {one.module.name} in {one.region.name}"))
    for name in dict(products):
        made = [what for other, what in products if other == name]
        if len(made) > 1:
            yield name, made

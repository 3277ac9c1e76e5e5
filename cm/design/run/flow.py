# SPDX-License-Identifier: Apache-2.0
"""The generated flow on disk: its steps, and which of them are outdated."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.plan.steps import Step, needed


class State(str, Enum):
    """Whether a step has to run."""

    DONE = "done"
    NEW = "new"  # never finished
    CHANGED = "changed"  # what it reads has changed
    AFTER = "after"  # a step before it has to run
    LOST = "lost"  # an output is gone


@dataclass(frozen=True, slots=True)
class Planned:
    """A step and its state."""

    step: Step
    state: State


class Flow:
    """The flow in an output folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / "steps.json"
        if not path.exists():
            raise BuildError(f"{folder} holds no generated flow: run cm build generate first")
        data = json.loads(path.read_text(encoding="utf-8"))
        self.steps = tuple(
            Step(entry["name"], entry["title"], tuple(entry["after"]), tuple(entry["outputs"]))
            for entry in data["steps"]
        )

    def plan(self, modules: Sequence[str] = ()) -> list[Planned]:
        """Return the steps in order, each with its state, as make would determine it.

        With `modules`, only the steps that their bitstreams need.
        """
        states: dict[str, State] = {}
        wanted = needed(self.steps, self.ends_of(modules) if modules else [step.name for step in self.steps])
        for step in self.steps:
            if step.name in wanted:
                states[step.name] = self._state(step, states)
        return [Planned(step, states[step.name]) for step in self.steps if step.name in wanted]

    def ends_of(self, modules: Sequence[str]) -> list[str]:
        """Return the steps that make the bitstreams of modules. Raises BuildError if there is none for a module."""
        found = []
        for name in modules:
            ends = [step.name for step in self.steps if f"bitstreams/{name}.bin" in step.outputs]
            if not ends:
                known = {Path(path).stem for step in self.steps for path in step.outputs if path.endswith(".bin")}
                raise BuildError(f"no step makes a bitstream of {name!r}; there are {', '.join(sorted(known))}")
            found += ends
        return found

    def unfinished(self) -> list[Planned]:
        """The steps that must still run for the bitstreams to be consistent; none if the flow ran elsewhere."""
        if not (self.folder / "stamps").is_dir():
            return []
        return [entry for entry in self.plan() if entry.state is not State.DONE]

    def forget(self, planned: list[Planned]) -> None:
        """Remove the stamps of steps whose outputs are gone, so that make runs them again."""
        for entry in planned:
            if entry.state is State.LOST:
                (self.folder / f"stamps/{entry.step.name}.done").unlink(missing_ok=True)

    def _state(self, step: Step, states: dict[str, State]) -> State:
        done = self.folder / f"stamps/{step.name}.done"
        if not done.exists():
            return State.NEW
        if done.read_text(encoding="utf-8") != self.checksums(step):
            return State.CHANGED
        if any(states[name] is not State.DONE for name in step.after):
            return State.AFTER
        stamp = done.stat().st_mtime_ns
        if any((self.folder / f"stamps/{name}.done").stat().st_mtime_ns > stamp for name in step.after):
            return State.AFTER
        if not all((self.folder / name).exists() for name in step.outputs):
            return State.LOST
        return State.DONE

    def checksums(self, step: Step) -> str:
        """The output of ``sha256sum`` for the step's inputs; a missing file is shown as missing."""
        names = (self.folder / f"inputs/{step.name}.list").read_text(encoding="utf-8").splitlines()
        return "".join(f"{digest(self.folder / name) or 'missing'}  {name}\n" for name in names)


def digest(path: Path) -> str:
    """SHA-256 of a file; empty if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""

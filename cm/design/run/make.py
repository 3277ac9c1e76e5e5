# SPDX-License-Identifier: Apache-2.0
"""`cm build run`: runs the generated flow by make, skipping steps whose inputs did not change."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cm.design.errors import MissingTool, StepFailed
from cm.design.run.flow import Flow, Planned, State
from cm.design.run.vivado import Vivado, excerpt

Tell = Callable[[str], None]


@dataclass(slots=True)
class _Progress:
    """Turns lines of make's output into sentences."""

    flow: Flow
    tell: Tell
    total: int
    finished: int = 0
    failed: list[str] | None = None

    def line(self, text: str, began: dict[str, float]) -> None:
        words = text.split()
        if len(words) != 3 or words[0] != "cm:":
            if text.strip() and not text.startswith("make"):
                self.tell(text.rstrip())
            return
        _, what, name = words
        title = next((step.title for step in self.flow.steps if step.name == name), name)
        if what == "start":
            began[name] = time.monotonic()
            self.tell(f"{name}: {title}")
        elif what == "done":
            self.finished += 1
            self.tell(f"{name}: done in {_duration(time.monotonic() - began[name])} ({self.finished} of {self.total})")
        elif what == "failed":
            self.failed = [*(self.failed or []), name]


def run_flow(folder: Path, vivado: Vivado, jobs: int, tell: Tell, modules: Sequence[str] = ()) -> list[Planned]:
    """Run the outdated steps below `folder`, at most `jobs` at once; return what was planned.

    With `modules`, only the steps that lead to their bitstreams.
    Raises `StepFailed` with an excerpt of the log. Run again, it continues where it stopped.
    """
    make = shutil.which("make")
    if make is None:
        raise MissingTool("the flow is run by make, which is not installed")
    flow = Flow(folder)
    planned = flow.plan(modules)
    todo = [entry for entry in planned if entry.state is not State.DONE]
    if not todo:
        tell("nothing to do: all steps are done and their inputs unchanged")
        return planned
    flow.forget(planned)
    progress = _Progress(flow, tell, len(todo))
    tell(f"{vivado}, {len(todo)} of {len(planned)} steps to run, {jobs} at once")
    targets = [f"stamps/{name}.done" for name in flow.ends_of(modules)] if modules else []
    program = f"VIVADO={_word(vivado.path)}"
    status = _make([make, f"-j{jobs}", "--no-print-directory", program, *targets], folder, progress)
    if progress.failed:
        raise StepFailed("\n".join(_failure(folder, name) for name in progress.failed))
    if status:
        raise StepFailed(f"make ended with status {status}")
    return planned


def _word(path: Path) -> str:
    """Write a path as a make variable that a recipe passes to its shell as one word."""
    return shlex.quote(str(path)).replace("$", "$$")


def _make(command: list[str], folder: Path, progress: _Progress) -> int:
    """Run make in its own process group, which is ended together with this process."""
    environment = {key: value for key, value in os.environ.items() if key not in ("MAKEFLAGS", "MAKELEVEL")}
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    began: dict[str, float] = {}
    try:
        assert process.stdout is not None
        for line in process.stdout:
            progress.line(line, began)
        return process.wait()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _failure(folder: Path, name: str) -> str:
    log = folder / f"logs/{name}.log"
    if not log.exists():
        log = folder / f"logs/{name}.out"
    told = "\n".join(f"    {line}" for line in excerpt(log))
    return f"step {name} failed; {log} says:\n{told}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"

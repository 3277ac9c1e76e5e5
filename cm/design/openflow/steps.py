# SPDX-License-Identifier: Apache-2.0
"""Steps that are skipped if their input is unchanged: each keeps a hash of its input."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import resource
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import ClassVar

from cm.design.errors import StepFailed
from cm.design.generate.output_tree import write_whole
from cm.design.openflow.tools import Tool

Tell = Callable[[str], None]
_LINES = 6
_OUT_OF_TIME = (-signal.SIGXCPU, -signal.SIGKILL)  # at the soft and the hard limit, which are equal


class OpenStepEndless(StepFailed):
    """A program of the open flow used all the processor time that it was allowed."""

    code: ClassVar[str] = "step_endless"


class Steps:
    """The steps of a flow in a folder; `tell` gets a sentence when a step begins and when it ends."""

    def __init__(self, folder: Path, tell: Tell, ran: list[str] | None = None) -> None:
        """`ran` collects the names of the steps that were run."""
        self.folder = folder
        self.ran = [] if ran is None else ran
        self._tell = tell

    def fresh(self, name: str, key: str, outputs: Iterable[Path]) -> bool:
        """Whether a step was run with this key and its outputs exist."""
        stamp = self.folder / f"{name}.key"
        return stamp.is_file() and stamp.read_text("utf-8") == key and all(path.is_file() for path in outputs)

    def step(self, name: str, title: str, key: str, outputs: Sequence[Path], work: Callable[[], None]) -> None:
        """Do `work` unless the step is fresh; the stamp is written last, so that a killed step starts again."""
        if self.fresh(name, key, outputs):
            return
        stamp = self.folder / f"{name}.key"
        stamp.unlink(missing_ok=True)
        self._tell(f"{name}: {title}")
        began = time.monotonic()
        work()
        write_whole(stamp, key.encode())
        self.ran.append(name)
        self._tell(f"{name}: done in {time.monotonic() - began:.0f} s")


def key_of(*parts: object) -> str:
    """Hash numbers, texts, JSON values and the contents of files; a missing file counts as empty."""
    total = hashlib.sha256()
    for part in parts:
        if isinstance(part, Path):
            data = part.read_bytes() if part.is_file() else b""
            total.update(f"{part.name} {len(data)} ".encode() + data)
        else:
            total.update(json.dumps(part, sort_keys=True, default=str).encode() + b"\n")
    return total.hexdigest()


def run_tool(
    tool: Tool,
    arguments: Sequence[str],
    log: Path,
    environment: dict[str, str],
    what: str,
    folder: Path | None = None,
    seconds: int | None = None,
) -> None:
    """Run a program for at most `seconds` of processor time, with its output in `log`.

    Raises StepFailed with its errors, or its last lines; OpenStepEndless.
    """
    surroundings = {**os.environ, **dict(tool.environment), **environment, "LC_ALL": "C"}
    with log.open("wb") as file:
        process = subprocess.Popen(
            [*tool.command, *arguments],
            stdout=file,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=surroundings,
            cwd=folder,
        )
        try:
            if seconds is not None:
                with contextlib.suppress(ProcessLookupError):  # it has ended
                    resource.prlimit(process.pid, resource.RLIMIT_CPU, (seconds, seconds))
            status = process.wait()
        except BaseException:
            process.kill()
            process.wait()
            raise
    if status in _OUT_OF_TIME and seconds is not None:
        raise OpenStepEndless(f"{what}: {tool.name} did not finish within {seconds} s of processor time")
    said = log.read_text("utf-8", errors="replace").splitlines()
    errors = [line for line in said if "ERROR" in line or "what():" in line or "Error:" in line]
    if status or any(line.startswith("ERROR") for line in errors):
        told = errors[:_LINES] or [line for line in said if line.strip()][-_LINES:]
        raise StepFailed(f"{what}: {tool.name} failed; {log} says:\n" + "\n".join(f"    {line}" for line in told))

# SPDX-License-Identifier: Apache-2.0
"""`cm build generate`: build schema → tree of files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cm.design.boundary.analyse import Analysis, analyse
from cm.design.check.rules import refuse_errors
from cm.design.errors import BuildError
from cm.design.generate.output_tree import Tree, Written
from cm.design.generate.outputs import render_all
from cm.design.plan.planner import plan_system
from cm.design.plan.system import System
from cm.design.project.load import load_project, normal
from cm.design.project.model import Project
from cm.design.runtime.answers import Answers, load_answers
from cm.schema import SchemaError, loads

OUT = "build"
ANSWERS = "answers.yaml"


@dataclass(frozen=True, slots=True)
class Design:
    """A project with what its HDL says, and the system planned around it."""

    project: Project
    analysis: Analysis
    system: System


def load_design(path: Path | str) -> Design:
    """Read, parse and plan; `SchemaError`, the HDL half's errors or `BuildError` where that cannot be done."""
    project = load_project(path)
    analysis = analyse(project)
    if analysis.refused:
        raise BuildError("modules that do not fit their region:\n  " + "\n  ".join(analysis.refused))
    return Design(project, analysis, plan_system(analysis.completed(project), analysis.boundaries))


def output_folder(project: Project, out: Path | str | None) -> Path:
    """Where generated files go: `out`, else ``build/`` beside the build schema."""
    return normal(Path(out)) if out is not None else project.folder / OUT


def generate(design: Design, out: Path, answers: Answers | None = None) -> Written:
    """Write everything below `out`; the answers to `cm build configure` are read from there.

    BuildError if Vivado would refuse the design.
    """
    refuse_errors(design.system)
    files = _files(design, out, answers)
    name = f"config/{design.project.name}.yaml"
    try:
        loads(files[name], name)
    except SchemaError as error:
        raise BuildError(f"{out / ANSWERS} and {design.project.source} contradict each other:\n{error}") from None
    return Tree(out).write(files)


def behind(design: Design, out: Path) -> list[str]:
    """Names of the files below `out` whose generated text would differ now."""
    return Tree(out).behind(_files(design, out, None))


def _files(design: Design, out: Path, answers: Answers | None) -> dict[str, str]:
    return render_all(design.system, out, load_answers(out / ANSWERS) if answers is None else answers)

# SPDX-License-Identifier: Apache-2.0
"""Proposals that can be generated: if the planner or a check refuses a partition, one with fewer regions is tried."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import yaml

from cm.design.boundary import boundary
from cm.design.boundary.analyse import Analysis
from cm.design.check.rules import check_system
from cm.design.errors import BuildError
from cm.design.partition.advisor import SECONDS, advise
from cm.design.partition.model import Partition, Problem
from cm.design.partition.proposal import propose
from cm.design.plan.planner import plan_system
from cm.design.project.load import load_project, project_data
from cm.design.project.model import Project
from cm.schema.problems import SchemaError

_HEAD = """\
# yaml-language-server: $schema=build.schema.json
# What `cm build partition` proposes: {name} with other regions. New regions have `pblock: auto`.
# Where one stream has become several, each has a new name, which programs have to use.
"""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A partition that can be generated, as the text of a build schema; `notes`: what was refused before it."""

    partition: Partition
    text: str
    notes: tuple[str, ...] = ()


def proposal(
    project: Project, analysis: Analysis, problem: Problem, objective: str = "worst", seconds: float = SECONDS
) -> Proposal:
    """Return the best partition that can be generated. Raises BuildError if there is none.

    `seconds` is the limit of all searches together, but each gets at least one second.
    """
    data = project_data(project.source)
    notes: list[str] = []
    end = time.monotonic() + seconds
    while True:
        found = advise(problem, objective, max(1.0, end - time.monotonic()))
        text = schema_text(project.source.name, propose(project, data, analysis, found))
        refused = refusals(project, analysis, text)
        if not refused:
            return Proposal(found, text, tuple(notes))
        count = len(found.groups)
        if count == 1:
            raise BuildError("no partition can be generated; the last one:\n  " + "\n  ".join(refused))
        notes.append(f"{count} regions cannot be generated: {refused[0]}")
        problem = replace(problem, regions=count - 1)


def schema_text(name: str, data: Mapping[str, Any]) -> str:
    """Write data as the text of a build schema."""
    body: str = yaml.safe_dump(dict(data), sort_keys=False, allow_unicode=True, width=110, default_flow_style=None)
    return _HEAD.format(name=name) + "\n" + body


def refusals(project: Project, analysis: Analysis, text: str) -> list[str]:
    """Return why the build schema `text`, with the modules of `project`, cannot be generated; empty if it can."""
    try:
        other = load_project(project.source, text)
        boundaries = {}
        for region in other.regions:
            names = [module.name for module in other.modules_of(region)]
            boundaries[region] = boundary([analysis.modules[name] for name in names], labels=names)
        changed = replace(analysis, boundaries=boundaries)
        if changed.refused:
            return list(changed.refused)
        found = check_system(plan_system(changed.completed(other), boundaries))
    except SchemaError as error:
        return [problem.message for problem in error.problems]
    except BuildError as error:
        return [str(error)]
    return [f"{finding.message} [{finding.rule}]" for finding in found if finding.error]

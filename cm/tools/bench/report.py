# SPDX-License-Identifier: Apache-2.0
"""A run as a table for people and as JSON for programs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cm.tools.bench.result import Result

if TYPE_CHECKING:
    from cm.tools.bench.compare import Pair

HEADERS = ("measurement", "value", "baseline", "ratio", "goal", "")


def rows(results: Iterable[Result]) -> list[tuple[str, ...]]:
    """One row for each result."""
    return [_row(result) for result in results]


def _row(result: Result) -> tuple[str, ...]:
    value = f"{result.value:.4g} {result.unit}" if result.value is not None else "-"
    baseline = f"{result.baseline:.4g} {result.unit}" if result.baseline is not None else "-"
    ratio = f"{result.ratio:.3g}" if result.ratio is not None else "-"
    verdict = {True: "met", False: "not met", None: result.missing}[result.met]
    return (result.name, value, baseline, ratio, str(result.goal or "-"), verdict)


def write(path: Path, results: Iterable[Result | Pair], machine: Mapping[str, Any]) -> None:
    """The JSON file: each result by its name, and `machine`."""
    found = {"machine": dict(machine), **{result.name: result.plain() for result in results}}
    path.write_text(json.dumps(found, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")

# SPDX-License-Identifier: Apache-2.0
"""Every measurement runs in its quick form and gives results of the promised shape. No test looks at a clock."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from cm.cli.main import main
from cm.tools.bench.catalogue import CASES, NAMES, Case

pytestmark = pytest.mark.timeout(900)
KEYS = {"value", "unit", "baseline", "ratio", "goal", "met", "missing", "ran"}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.module)
def test_a_measurement_runs(case: Case, tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    assert main(["bench", *case.names, "--quick", "--json", str(file)]) == 0
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    assert set(found) == {"machine", *case.names}
    for name in case.names:
        assert found[name].keys() >= KEYS
        assert found[name]["ran"]
        assert (found[name]["value"] is None) == bool(found[name]["missing"])


def test_the_names_are_those_of_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--list"]) == 0
    assert tuple(capsys.readouterr().out.split()) == NAMES


def test_two_trees_are_measured_in_turns(tmp_path: Path) -> None:
    file = tmp_path / "both.json"
    assert main(["bench", "--compare", sys.prefix, "--quick", "--json", str(file)]) == 0
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    assert found["machine"]["quick"]
    assert {len(found["read µs"][side]) for side in ("other", "this", "ratios")} == {2}
    assert found["read, calls of the client"]["ratio"] == 1
    assert found["read, calls of the manager"]["ratio"] == pytest.approx(1, abs=0.03)


def test_a_folder_without_an_environment_is_not_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--compare", str(tmp_path), "--quick"]) == 1
    assert "neither .venv/bin/python nor bin/python" in capsys.readouterr().err

# SPDX-License-Identifier: Apache-2.0
"""Every measurement runs in its quick form and gives results of the promised shape. No test looks at a clock."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cm.cli.main import main
from cm.tools.bench.table import CASES, NAMES, Case

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

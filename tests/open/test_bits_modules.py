# SPDX-License-Identifier: Apache-2.0
"""The modules of the open flow by their bits against their own Verilog, for a million cycles each."""

from __future__ import annotations

from pathlib import Path

import pytest
from twins import Built, compare

from cm.simulation.bits.cells import Dsp

pytestmark = pytest.mark.timeout(900)
CYCLES = 1_000_000
RESET = 40  # cycles after which what has no first value in Verilog has one


@pytest.mark.parametrize(
    ("fixture", "names"), [("open_project", ("default", "edge", "colorise")), ("open_pair", ("colour_right",))]
)
def test_a_million_cycles_of_a_modules_bits_equal_those_of_its_verilog(
    request: pytest.FixtureRequest, tmp_path: Path, fixture: str, names: tuple[str, ...]
) -> None:
    built = Built(request.getfixturevalue(fixture), tmp_path)
    twins = [built.twin(name) for name in names]
    for twin in twins:
        assert not twin.netlist.notes
        assert any(isinstance(cell, Dsp) for cell in twin.netlist.cells) == (twin.name == "colour_right")
    results = compare(tmp_path, twins, CYCLES, RESET)
    assert {name: one.wrong for name, one in results.items()} == dict.fromkeys(names, 0)
    assert all(one.changes > CYCLES // 4 for one in results.values()), results

# SPDX-License-Identifier: Apache-2.0
"""The AXI4 decouplers, simulated: protocol on the static side whatever the region does."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import HERE, needs
from simulation import simulate

RTL = HERE.parent.parent / "cm" / "design" / "rtl"

pytestmark = [needs("iverilog"), pytest.mark.timeout(600)]


@pytest.mark.parametrize(("side", "count"), [("slave", 4), ("master", 2)])
def test_a_decoupler_keeps_the_protocol(side: str, count: int, tmp_path: Path) -> None:
    top = f"tb_axi_{side}_decoupler"
    sources = [HERE / f"tb/{top}.v", *sorted(RTL.glob("cm_axi_*.v"))]
    assert len(simulate(top, sources, "cocotb_axi_decouplers", tmp_path, only=f"{side}_.*")) == count

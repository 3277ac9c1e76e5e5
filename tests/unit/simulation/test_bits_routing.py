# SPDX-License-Identifier: Apache-2.0
"""Where a wire's value comes from, on a tile of three wires."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from cm.formats.xray import Feature, Pip
from cm.simulation.bits.routing import Constant, Routing

PIPS = [Pip("LVB0", "LVB12", both_ways=True, pseudo=False), Pip("GND_WIRE", "LVB12", both_ways=False, pseudo=False)]
PIPS += [Pip("VCC_WIRE", "LVB0", both_ways=False, pseudo=False)]


def sources(wire: str, *features: str) -> tuple[object, ...]:
    kind = SimpleNamespace(pips={pip.feature: pip for pip in PIPS}, sites=())
    wires: Any = SimpleNamespace(kind=lambda _: kind, node=lambda tile, name: frozenset({(tile, name)}))
    segbits = SimpleNamespace(features={})
    database: Any = SimpleNamespace(
        tiles={"T": SimpleNamespace(kind="INT_R")}, ppips=lambda _: {}, segbits=lambda _: segbits
    )
    return Routing(database, wires, [Feature("T", name) for name in features]).sources("T", wire)


def test_a_switch_that_leads_both_ways_is_followed_in_each_direction() -> None:
    assert sources("LVB12", "LVB12.LVB0", "LVB0.VCC_WIRE") == (Constant(True),)
    assert sources("LVB0", "LVB0.LVB12", "LVB12.GND_WIRE") == (Constant(False),)


def test_a_wire_that_no_switch_leads_to_has_no_source() -> None:
    assert sources("LVB0", "LVB12.LVB0") == ()

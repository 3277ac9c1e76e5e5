# SPDX-License-Identifier: Apache-2.0
"""Every port of the top needs a package pin and an I/O standard, or write_bitstream stops (NSTD-1, UCIO-1)."""

from __future__ import annotations

from collections.abc import Iterator

from cm.design.check.finding import Finding
from cm.design.plan.pins import placements
from cm.design.plan.system import System


def check_pins(system: System) -> Iterator[Finding]:
    """A finding for each port without a pin, and for each impossible pin."""
    hint = "name pins of the board under pins:, or give both in a file of static: constraints"
    for fault in placements(system)[1]:
        rule, said = ("DRC UCIO-1", hint) if fault.missing else ("pins", "")
        yield Finding(rule, fault.key, fault.message, said)

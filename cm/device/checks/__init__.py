# SPDX-License-Identifier: Apache-2.0
"""Checks a Zynq's kernel and device tree for what would prevent a first frame, and says what to do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from cm.device.checks.machine import Machine
from cm.device.paths import Root

if TYPE_CHECKING:
    from cm.device.check_result import Finding


def board_checks(root: Root) -> Iterator[Finding]:
    """All checks, if this is a board of the Zynq families; nothing on other machines and on simulated boards."""
    machine = Machine(root)
    if machine.family is None:
        return
    from cm.device.checks import devices, kernel, other_managers, ps_pl_ports  # here: a manager needs only the machine

    yield from kernel.checks(machine)
    yield from devices.checks(machine)
    yield from ps_pl_ports.checks(machine)
    yield from other_managers.checks(machine)

# SPDX-License-Identifier: Apache-2.0
"""Registers of common IPs whose instances do not always describe them in the `.hwh` (PG144, PG079)."""

from __future__ import annotations

from cm.formats.hwh.model import ModuleInstance, RegisterInfo

_GPIO = (
    (0x000, "GPIO_DATA", "Channel 1 data"),
    (0x004, "GPIO_TRI", "Channel 1 direction: 1 is input"),
    (0x11C, "GIER", "Bit 31: global interrupt enable"),
    (0x120, "IP_ISR", "Interrupt status, one bit a channel; 1 toggles"),
    (0x128, "IP_IER", "Interrupt enable, one bit a channel"),
)
_GPIO_DUAL = (
    (0x008, "GPIO2_DATA", "Channel 2 data"),
    (0x00C, "GPIO2_TRI", "Channel 2 direction: 1 is input"),
)
_TIMER = (
    (0x00, "TCSR0", "Timer 0 control and status"),
    (0x04, "TLR0", "Timer 0 load"),
    (0x08, "TCR0", "Timer 0 counter"),
    (0x10, "TCSR1", "Timer 1 control and status"),
    (0x14, "TLR1", "Timer 1 load"),
    (0x18, "TCR1", "Timer 1 counter"),
)
_READ_ONLY = {"TCR0", "TCR1"}


def registers(module: ModuleInstance, interface: str) -> tuple[RegisterInfo, ...]:
    """The registers that the instance describes behind this interface, or else those that its type is known to have."""
    described = module.registers.get(interface, ())
    if described:
        return described
    if module.type == "axi_gpio":
        dual = module.parameters.get("C_IS_DUAL") == "1"
        return _infos(sorted((*_GPIO, *(_GPIO_DUAL if dual else ()))))
    return _infos(_TIMER) if module.type == "axi_timer" else ()


def _infos(rows: tuple[tuple[int, str, str], ...] | list[tuple[int, str, str]]) -> tuple[RegisterInfo, ...]:
    return tuple(
        RegisterInfo(name, offset, 32, "read-only" if name in _READ_ONLY else "read-write", doc=doc)
        for offset, name, doc in rows
    )

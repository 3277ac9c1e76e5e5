# SPDX-License-Identifier: Apache-2.0
"""The bit by which a region is cut off from the static part."""

from __future__ import annotations

from cm.manager.access.register_bus import RegisterAccess
from cm.manager.errors import VerifyFailed
from cm.schema.model import Decoupler


def drive(registers: RegisterAccess, decoupler: Decoupler, cut: bool) -> None:
    """Set a decoupler's bit and read it back: a region believed cut off must be. Raises VerifyFailed, DeviceError."""
    address, bit = _address(decoupler), 1 << decoupler.bit
    before = registers.read_address(address, decoupler.width)
    wanted = before | bit if cut == decoupler.active_high else before & ~bit
    registers.write_address(address, decoupler.width, wanted)
    after = registers.read_address(address, decoupler.width)
    if (after ^ wanted) & bit:
        raise VerifyFailed(f"the decoupler at {address:#x} bit {decoupler.bit} reads {after:#x} after {wanted:#x}")


def is_cut(registers: RegisterAccess, decoupler: Decoupler) -> bool:
    """Whether the region is cut off now. Raises DeviceError."""
    value = registers.read_address(_address(decoupler), decoupler.width)
    return bool(value >> decoupler.bit & 1) == decoupler.active_high


def _address(decoupler: Decoupler) -> int:
    return decoupler.base_address + decoupler.offset

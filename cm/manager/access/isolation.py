# SPDX-License-Identifier: Apache-2.0
"""What cuts a region off from the static part: bits, sequences of registers, GPIO lines."""

from __future__ import annotations

import time

from cm.manager.access.register_bus import RegisterBus
from cm.manager.errors import VerifyFailed
from cm.schema.model import Decoupler, GpioLine, IsolationStep

_BETWEEN = 0.001  # seconds between two looks at a register that is waited for


def drive(registers: RegisterBus, decoupler: Decoupler, cut: bool) -> None:
    """Cut a region off, or connect it: a region believed cut off must be, so what is written is read back.

    Raises VerifyFailed, DeviceError; of a sequence some steps may have been taken then.
    """
    if decoupler.gpio is not None:
        _drive_line(registers, decoupler.gpio, int(cut == decoupler.active_high))
        return
    address = decoupler.base_address + decoupler.offset
    for step in decoupler.sequence or (_of_bit(decoupler),):
        value = step.cut if cut else step.couple
        mask = (1 << decoupler.width) - 1 if step.mask is None else step.mask
        if step.poll:
            _await(registers, address + step.offset, decoupler.width, (value & mask, mask, step.timeout))
        else:
            _set(registers, address + step.offset, decoupler.width, (value & mask, mask, step.verify))


def is_cut(registers: RegisterBus, decoupler: Decoupler) -> bool:
    """Whether the region is cut off now; False where its registers cannot be read back. Raises DeviceError."""
    if decoupler.gpio is not None:
        return registers.read_line(decoupler.gpio) == int(decoupler.active_high)
    address, all_bits = decoupler.base_address + decoupler.offset, (1 << decoupler.width) - 1
    told = [step for step in decoupler.sequence or (_of_bit(decoupler),) if step.verify or step.poll]
    for step in told:
        mask = all_bits if step.mask is None else step.mask
        if (registers.read_address(address + step.offset, decoupler.width) ^ step.cut) & mask:
            return False
    return bool(told)


def _drive_line(registers: RegisterBus, line: GpioLine, value: int) -> None:
    registers.drive_line(line, value)
    after = registers.read_line(line)
    if after != value:
        raise VerifyFailed(f"the decoupler, line {line.line} of {line.chip}, reads {after} after {value}")


def _of_bit(decoupler: Decoupler) -> IsolationStep:
    bit = 1 << decoupler.bit
    cut, couple = (bit, 0) if decoupler.active_high else (0, bit)
    return IsolationStep(0, cut, couple, mask=bit)


def _set(registers: RegisterBus, address: int, width: int, wanted: tuple[int, int, bool]) -> None:
    value, mask, verify = wanted
    whole = mask == (1 << width) - 1
    written = value if whole else registers.read_address(address, width) & ~mask | value
    registers.write_address(address, width, written)
    after = registers.read_address(address, width) if verify else written
    if (after ^ written) & mask:
        raise VerifyFailed(f"the decoupler at {address:#x} reads {after:#x} after {written:#x} (bits {mask:#x})")


def _await(registers: RegisterBus, address: int, width: int, wanted: tuple[int, int, float]) -> None:
    value, mask, timeout = wanted
    until = time.monotonic() + timeout
    while ((there := registers.read_address(address, width)) ^ value) & mask:
        if time.monotonic() >= until:
            raise VerifyFailed(
                f"the decoupler at {address:#x} reads {there:#x} after {timeout:g} s, not {value:#x} (bits {mask:#x})"
            )
        time.sleep(_BETWEEN)

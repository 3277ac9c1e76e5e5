#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: PYNQ's register map takes any .hwh: names are only names, and a 16-bit register is read as one.
# Seen: a field called `width` ends its repr in a RecursionError; a register of 16 bits gives its neighbour too; [0:3] is [3:0] with the bits in the opposite
# order; and -1 in a field sets every bit above it.
. "$(dirname "$0")/setup"
pypi pynq==4.0.0
python3 - 2>/dev/null <<'END'
import numpy as np
from pynq.registers import RegisterMap
from saw import saw


def field(offset, width):
    return {"bit_offset": offset, "bit_width": width, "access": "read-write", "description": ""}


def register(offset, size, **fields):
    return {"address_offset": offset, "size": size, "access": "read-write", "description": "", "fields": fields}


def registers(words, **described):
    return RegisterMap.create_subclass("Map", described)(np.array(words, dtype=np.uint32))


words = np.array([0x0000000D, 0xBBBBAAAA], dtype=np.uint32)
device = RegisterMap.create_subclass(
    "Device", {"control": register(0, 32, mode=field(4, 4)), "low": register(4, 16), "high": register(6, 16)}
)(words)
saw("the low half reads as", hex(int(device.low)), "0xbbbbaaaa")
saw("the high half reads as", hex(int(device.high)), "0xbbbbaaaa")
saw("0xd as [3:0] and as [0:3]", (device.control[3:0], device.control[0:3]), (13, 11))
device.control.mode = -1
saw("mode = -1 writes", hex(int(words[0])), "0xfffffffd")
try:
    size = repr(registers([0] * 4, size=register(0, 32, width=field(0, 12), height=field(12, 12))))
except RecursionError:
    size = "RecursionError"
saw("a field called width", size, "RecursionError")
END

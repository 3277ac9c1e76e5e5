#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: in QEMU's Zynq, too, PCFG_DONE says that a bitstream has configured the fabric.
# Seen: it is there after reset, and again as soon as it is cleared, before a word has come; a load of nothing but NOPs
# and the IDCODE of another device ends like a good one. A test on this board shows that bytes are moved, no more.
. "$(dirname "$0")/setup"
suite sid qemu-system-arm
QEMU="$there root/usr/bin/qemu-system-arm -L root/usr/share/qemu -M xilinx-zynq-a9 -m 64" python3 - <<'END'
import struct
from qemu_bus import Bus
from saw import saw

DEVCFG, RAM = 0xF8007000, 0x100000
CTRL, INT_STS, STATUS = DEVCFG, DEVCFG + 0xC, DEVCFG + 0x14
SOURCE, TARGET, SOURCE_WORDS, TARGET_WORDS = (DEVCFG + offset for offset in (0x18, 0x1C, 0x20, 0x24))
PROG_B, PCFG_DONE, DMA_DONE, PCFG_INIT, ERRORS = 1 << 30, 1 << 2, 1 << 13, 1 << 4, 0x74C860

with Bus() as bus:
    before = bool(bus.read(INT_STS) & PCFG_DONE)
    bus.write(INT_STS, 0xFFFFFFFF)
    saw("PCFG_DONE after reset, and cleared", (before, bool(bus.read(INT_STS) & PCFG_DONE)), (True, True))
    bus.write(CTRL, bus.read(CTRL) | PROG_B)
    saw("PROG_B high: PCFG_INIT", bool(bus.read(STATUS) & PCFG_INIT), True)
    bus.write(INT_STS, 0xFFFFFFFF)
    words = [0xFFFFFFFF] * 8 + [0xAA995566, 0x20000000, 0x30018001, 0x0BAD0093] + [0x20000000] * 20
    bus.store(RAM, struct.pack(f"<{len(words)}I", *words))
    for register, value in ((SOURCE, RAM | 1), (TARGET, 0xFFFFFFFF), (SOURCE_WORDS, len(words)), (TARGET_WORDS, 0)):
        bus.write(register, value)
    done = bus.read(INT_STS)
    saw("another device's: DMA done, errors, PCFG_DONE", (bool(done & DMA_DONE), done & ERRORS, bool(done & PCFG_DONE)), (True, 0, True))
END

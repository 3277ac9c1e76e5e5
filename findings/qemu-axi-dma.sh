#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: QEMU's AXI DMA behaves as its product guide PG021 says, so a driver for the core runs on the model.
# Seen: DMASR lacks SGIncld, by which Linux' xilinx_dma takes it for an engine without descriptors (read in the driver);
# a LENGTH written for such an engine is kept and moves nothing. A used descriptor halts it without an error bit, a
# threshold of 0 is taken, and a reset of one channel leaves the other running. QEMU 7.2 does the same.
. "$(dirname "$0")/setup"
suite sid qemu-system-misc
QEMU="$there root/usr/bin/qemu-system-microblaze -L root/usr/share/qemu -M petalogix-ml605" python3 - <<'END'
import struct
from qemu_bus import Bus
from saw import saw

MM2S, S2MM, RAM = 0x84600000, 0x84600030, 0x50000000
CR, SR, CURRENT, TAIL, SOURCE, LENGTH = 0x0, 0x4, 0x8, 0x10, 0x18, 0x28
HALTED, SGINCLD, ERRORS, IOC = 1, 1 << 3, 0x770, 1 << 12
DONE = 1 << 31


def sent(bus: Bus, status: int) -> tuple[bool, bool, bool, bool]:
    """Send one descriptor of 64 bytes whose status is `status`."""
    bus.write(MM2S + CR, 4)
    bus.store(RAM, struct.pack("<8I", RAM + 0x40, 0, RAM + 0x1000, 0, 0, 0, 0x0C000040, status))
    for register, value in ((CURRENT, RAM), (CR, 0x17001), (TAIL, RAM)):
        bus.write(MM2S + register, value)
    now = bus.read(MM2S + SR)
    return bool(struct.unpack("<I", bus.load(RAM + 0x1C, 4))[0] & DONE), bool(now & IOC), bool(now & HALTED), bool(now & ERRORS)


with Bus() as bus:
    status = bus.read(MM2S + SR)
    saw("after reset: halted, SGIncld", (bool(status & HALTED), bool(status & SGINCLD)), (True, False))
    bus.write(MM2S + CR, 0x0001)
    saw("a threshold of 0 is read as", bus.read(MM2S + CR) >> 16 & 0xFF, 0)
    bus.write(MM2S + SOURCE, RAM)
    bus.write(MM2S + LENGTH, 64)
    saw("a transfer without descriptors: LENGTH, interrupt", (bus.read(MM2S + LENGTH), bool(bus.read(MM2S + SR) & IOC)), (64, False))
    saw("a descriptor: done, interrupt, halted, error", sent(bus, 0), (True, True, False, False))
    saw("a used descriptor", sent(bus, DONE), (True, False, True, False))
    bus.write(S2MM + CR, 1)
    bus.write(MM2S + CR, 4)
    saw("S2MM runs on after a reset of MM2S", bus.read(S2MM + CR) & 1, 1)
END

#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a write of one byte through LiteX's bridge from AXI4-Lite to its registers changes that byte, or is refused.
# Seen: any strobe writes the whole register from the bus, so the other bytes take what happens to lie there. Without
# a strobe nothing is written. All is answered with OKAY, also where no register is.
. "$(dirname "$0")/setup"
pypi litex==2024.12 migen==0.10.0
cat >design.py <<'END'
from litex.gen import LiteXModule
from litex.soc.interconnect import csr, csr_bus
from litex.soc.interconnect.axi import AXILite2CSR, AXILiteInterface
from migen import run_simulation
from saw import saw


class Device(LiteXModule):
    def __init__(self):
        self.gain = csr.CSRStorage(32, name="gain", reset=0x11223344)


class Design(LiteXModule):
    def __init__(self):
        self.axi = AXILiteInterface(data_width=32, address_width=32)
        self.bus = csr_bus.Interface(data_width=32)
        self.bridge = AXILite2CSR(self.axi, self.bus)
        self.device = Device()
        self.bank = csr_bus.CSRBank(self.device.get_csrs(), bus=self.bus, address=0)


design, seen = Design(), []


def asks():
    for data, strobes in ((0xFF, 0b0001), (0xDEADBEEF, 0)):
        response = yield from design.axi.write(0, data, strb=strobes)
        value, _ = yield from design.axi.read(0)
        seen.append((response, hex(value)))
    seen.append((yield from design.axi.write(0x100, 1)))
    seen.append((yield from design.axi.read(0x100)))


run_simulation(design, asks())
saw("0x11223344 after a write of one byte, 0xff", seen[0], (0, "0xff"))
saw("after a write without strobes", seen[1], (0, "0xff"))
saw("the answer to a write where no register is", seen[2], 0)
saw("data and answer of a read there", tuple(seen[3]), (0, 0))
END
python3 -W ignore design.py

#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a LiteX design with csr_ordering="little" says so in the csr.json and csr.h that describe it.
# Seen: the gateware puts the low word first, the files are the same to the letter, and the C functions in csr.h go on
# reading the high word first.
. "$(dirname "$0")/setup"
pypi litex==2024.12 migen==0.10.0
cat >design.py <<'END'
import json
import logging

from litex.build.generic_platform import Pins
from litex.build.sim import SimPlatform
from litex.gen import LiteXModule
from litex.soc.integration.export import get_csr_header, get_csr_json
from litex.soc.integration.soc_core import SoCMini
from litex.soc.interconnect.csr import CSRStorage
from migen import ClockDomain
from saw import saw

logging.disable(logging.CRITICAL)


class Device(LiteXModule):
    def __init__(self):
        self.wide = CSRStorage(64, name="wide")


class Clock(LiteXModule):
    def __init__(self, pin):
        self.cd_sys = ClockDomain(reset_less=True)
        self.comb += self.cd_sys.clk.eq(pin)


class Design(SoCMini):
    def __init__(self, ordering):
        platform = SimPlatform("SIM", [("clk", 0, Pins(1))])
        super().__init__(platform, int(1e6), csr_data_width=32, csr_ordering=ordering, ident="", ident_version=False)
        self.crg = Clock(platform.request("clk"))
        self.dev = Device()


def files(ordering):
    design = Design(ordering)
    design.finalize()
    words = [word.name for word in design.dev.wide.get_simple_csrs()]
    registers = json.loads(get_csr_json(design.csr_regions, design.constants, design.mem_regions))["csr_registers"]
    return words, registers["dev_wide"], get_csr_header(design.csr_regions, design.constants)


big, little = files("big"), files("little")
saw("words of a 64-bit register in the gateware, big", big[0], ["wide1", "wide0"])
saw("little", little[0], ["wide0", "wide1"])
saw("csr.json is the same", big[1] == little[1], True)
saw("csr.h is the same", big[2] == little[2], True)
END
python3 -W ignore design.py 2>/dev/null

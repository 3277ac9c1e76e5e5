# SPDX-License-Identifier: Apache-2.0
"""Frames of a 7-series device as a netlist that can be simulated: what runs is what the bits configure."""

from cm.bits.cells import Carry as Carry
from cm.bits.cells import FlipFlop as FlipFlop
from cm.bits.cells import Lut as Lut
from cm.bits.cells import LutMemory as LutMemory
from cm.bits.cells import Mux as Mux
from cm.bits.cells import Netlist as Netlist
from cm.bits.errors import BitsError as BitsError
from cm.bits.extract import Boundary as Boundary
from cm.bits.extract import extract as extract
from cm.bits.verilog import Port as Port
from cm.bits.verilog import verilog as verilog

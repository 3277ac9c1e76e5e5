# SPDX-License-Identifier: Apache-2.0
"""Frames of a 7-series device as a netlist that can be simulated: what runs is what the bits configure."""

from cm.simulation.bits.cells import FlipFlop as FlipFlop
from cm.simulation.bits.cells import Lut as Lut
from cm.simulation.bits.cells import LutMemory as LutMemory
from cm.simulation.bits.cells import Netlist as Netlist
from cm.simulation.bits.extract import Boundary as Boundary
from cm.simulation.bits.extract import extract as extract
from cm.simulation.bits.verilog import Port as Port
from cm.simulation.bits.verilog import verilog as verilog

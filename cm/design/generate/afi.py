# SPDX-License-Identifier: Apache-2.0
"""Widths of the AXI ports between processing system and PL, as linux-xlnx's drivers set them.

The boot loader sets them from the hardware description that it was built with; a design that is loaded later may need
others. The widths here are those that `block_design` uses.

- UltraScale+: ``config-afi`` of linux-xlnx's drivers/fpga/xilinx-afi.c, pairs of a register of PM_AFI and its value:
  2n and 2n+1 are AFIFM<n>.RDCTRL and WRCTRL (0, 1: HPC; 2 to 5: HP), 0 for 128 bits; 14 is FPD_SLCR.afi_fs, 0xa00
  for 128 bits at both HPM ports (UG1085, UG1087).
- Zynq-7000: one node for each port, 0 for 64 bits (drivers/fpga/zynq-afi.c reads ``xlnx,afi-width``, its binding says
  ``xlnx,afi-buswidth``: both stand here); AFI0 to AFI3 are at 0xf8008000 and every 0x1000 behind (UG585, appendix B.3).
"""

from __future__ import annotations

from dataclasses import dataclass

from cm.design.plan.ports import memory_ports
from cm.design.plan.system import System

_AFI_FS, _AFI_FS_128 = 14, 0xA00
_AFI_BASE = 0xF8008000


@dataclass(frozen=True, slots=True)
class Node:
    """A node and the lines in it."""

    name: str
    properties: tuple[str, ...]


def nodes(system: System) -> list[Node]:
    """The nodes for the ports that a system uses."""
    ports = [port for port, _ in memory_ports(system)]
    if system.platform.ultrascale:
        pairs = [(2 * port.afi + channel, 0) for port in ports for channel in (0, 1)]
        listed = ", ".join(f"<{register} {value:#x}>" for register, value in [*pairs, (_AFI_FS, _AFI_FS_128)])
        return [Node("cm-afi", ('compatible = "xlnx,afi-fpga";', f"config-afi = {listed};"))]
    return [_zynq(port.afi) for port in ports]


def _zynq(index: int) -> Node:
    base = _AFI_BASE + 0x1000 * index
    lines = (
        'compatible = "xlnx,zynq-afi-fpga";',
        f"reg = <{base:#010x} 0x1000>;",
        "xlnx,afi-width = <0>;",
        "xlnx,afi-buswidth = <0>;",
    )
    return Node(f"cm-afi@{base:x}", lines)

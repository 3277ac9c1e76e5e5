# SPDX-License-Identifier: Apache-2.0
"""Chooses the ports of the processing system that connect the design to memory."""

from __future__ import annotations

from dataclasses import dataclass

from cm.design.errors import BuildError
from cm.design.plan.system import System

MAX_SLAVES = 16  # at one SmartConnect (PG247)
HPM_WIDTH = 128  # bits of UltraScale+'s register ports
WIDTH = {False: 64, True: 128}  # bits of a memory port; the key: UltraScale+ or not


@dataclass(frozen=True, slots=True)
class MemoryPort:
    """A slave port of the processing system; `setting`: its number in parameters; `afi`: the number of its AFI.

    `prefix`: how the names of its pins begin, needed for coherent ports only.
    """

    slave: str
    clock: str
    setting: int
    afi: int
    coherent: bool = False

    @property
    def prefix(self) -> str:
        """The beginning of its signals' names: ``saxigp0``."""
        return f"saxigp{self.setting}"


def memory_ports(system: System) -> list[tuple[MemoryPort, int]]:
    """Return ports with their number of masters: first those of regions and their engines, last that of the ICAP.

    If a port is left, the ICAP's engine has the last one to itself, so that loads do not wait for streams. On
    Zynq-7000 that is HP3, which shares its path to the memory controller with HP2 only (UG585, chapter 5).
    """
    platform, coherent = system.platform, system.project.static.coherent
    slaves = platform.coherent_slaves if coherent else platform.memory_slaves
    clocks = platform.coherent_clocks if coherent else platform.memory_clocks
    # UltraScale+: S_AXI_GP0 and GP1 are HPC0 and HPC1, GP2 to GP5 are HP0 to HP3; AFIs have the same numbers (UG1085)
    first = 2 if platform.ultrascale and not coherent else 0
    masters = sum(engine.masters for engine in system.engines) + sum(len(region.memory) for region in system.regions)
    own = system.engines[0].masters if system.icap else 0
    apart = own if 0 < -(-(masters - own) // MAX_SLAVES) < len(slaves) else 0
    counts = [min(MAX_SLAVES, masters - apart - done) for done in range(0, masters - apart, MAX_SLAVES)]
    if len(counts) > len(slaves):
        kind = "coherent ports" if coherent else "ports"
        message = f"{masters} masters to memory are more than the processing system's {kind} can take"
        raise BuildError(f"{message}: let streams share an engine (engine: NAME under the region's interfaces)")
    used = [*enumerate(counts), *([(len(slaves) - 1, apart)] if apart else [])]
    return [(MemoryPort(slaves[i], clocks[i], first + i, first + i, coherent), count) for i, count in used]

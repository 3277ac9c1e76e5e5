# SPDX-License-Identifier: Apache-2.0
"""Which ports of the processing system carry the design's way to memory."""

from __future__ import annotations

from dataclasses import dataclass

from cm.build.errors import BuildError
from cm.build.plan.system import System

MAX_SLAVES = 16  # of one SmartConnect (PG247)
HPM_WIDTH = 128  # bits of UltraScale+'s ports for registers
WIDTH = {False: 64, True: 128}  # bits of a port for memory, by UltraScale+


@dataclass(frozen=True, slots=True)
class MemoryPort:
    """A slave port of the processing system; `setting` is the number that its parameters have, `afi` that of its AFI.

    `prefix` begins the names of its pins; only those of coherent ports are ever named.
    """

    slave: str
    clock: str
    setting: int
    afi: int
    coherent: bool = False

    @property
    def prefix(self) -> str:
        """How the names of its signals begin: ``saxigp0``."""
        return f"saxigp{self.setting}"


def memory_ports(system: System) -> list[MemoryPort]:
    """As many ports as the masters of a system need, in their order."""
    platform, coherent = system.platform, system.project.static.coherent
    masters = 2 * len(system.dmas) + sum(len(region.memory) for region in system.regions)
    slaves = platform.coherent_slaves if coherent else platform.memory_slaves
    clocks = platform.coherent_clocks if coherent else platform.memory_clocks
    count = -(-masters // MAX_SLAVES)
    if count > len(slaves):
        kind = "coherent ports" if coherent else "ports"
        raise BuildError(f"{masters} masters to memory are more than the processing system's {kind} can take")
    # UltraScale+: S_AXI_GP0 and GP1 are HPC0 and HPC1, GP2 to GP5 HP0 to HP3, and the AFIs are counted alike (UG1085)
    first = 2 if platform.ultrascale and not coherent else 0
    return [MemoryPort(slaves[i], clocks[i], first + i, first + i, coherent) for i in range(count)]

# SPDX-License-Identifier: Apache-2.0
"""What differs between the processing systems: IP, ports, addresses, interrupts.

Kernel interrupt numbers count from 32 (`GIC_SPI`). Checked against public sources:

- interrupts of Zynq-7000: UG585 v1.11, 7.2.3 (IRQ 61 to 68 and 84 to 91, less 32);
- interrupts of UltraScale+: UG1085 2.4, table 35-6 (89 to 96, 104 to 111), PG201 3.4 (GIC 121 to 128, 136 to
  143), and Xilinx/device-tree-xlnx ac65e01, device_tree/data/common_proc.tcl (which pin has which);
- clocks of the ICAP: UG909 2022.2, "Configuration Time", tables 1 and 3.

- the PL's window of Zynq-7000: Xilinx/embeddedsw, cortexa9/iccarm/translation_table.s (GpAxi0: 0x40000000 to
  0x7fffffff);
- the PL's window of UltraScale+: Xilinx/embeddedsw, cortexa53/32bit/gcc/translation_table.s (0xA0000000 to 0xBFFFFFFF
  for HPM0 and HPM1), and designs that give M_AXI_HPM0_FPD 256 MB from 0xA0000000 (Xilinx/kria-dfx-hw 78a1236);
- pins of the PS: .hwh files of Vivado (ZCU106 in alliedvision/zynq-mipi-bitstreams 4f0f401, ZCU104 in byuccl/PYNQ-PRIO
  c7578a1, Zynq-7000 in RDC23/image_filtering_pynq 58f580c); clocks of HP1 to HP3: the base.tcl of Xilinx/PYNQ 19ed17d
  and Xilinx/kria-dfx-hw;
- segments of memory (HP0_DDR_LOWOCM to HP3_DDR_LOWOCM; SAXIGP2/HP0_DDR_LOW to SAXIGP5/HP3_DDR_LOW): the same Tcl files.
"""

from __future__ import annotations

from cm.design.errors import BuildError
from cm.design.parts import device_of
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Platform:
    """The properties of a SoC family that the generated block design needs."""

    name: str
    ps_ip: str
    ps_cell: str
    control_master: str  # AXI master of the PS for registers
    control_clock: str
    memory_slaves: tuple[str, ...]  # high-performance slaves of the PS
    memory_clocks: tuple[str, ...]
    coherent_slaves: tuple[str, ...]  # the same, but coherent with the processors' caches
    coherent_clocks: tuple[str, ...]
    clock_pins: tuple[str, ...]
    reset_pin: str
    irq_pins: tuple[tuple[str, int, int], ...]  # pin, lines, first GIC SPI
    base: int  # PL window of the control master
    size: int
    address_bits: int
    ultrascale: bool
    icap_rate_max: int  # Hz
    compatible: str  # device tree of the board's SoC
    taken: tuple[int, ...] = ()  # SPIs of the PL that the board's stock image gives to others

    @property
    def irq_wires(self) -> list[tuple[str, int]]:
        """All wires from PL to PS, as pin and SPI; `spi` leaves out those that are taken."""
        return [(pin, first + bit) for pin, lines, first in self.irq_pins for bit in range(lines)]

    @property
    def irq_count(self) -> int:
        """Interrupt lines from PL to PS that a design may use."""
        return len(self._free)

    def spi(self, line: int) -> int:
        """GIC SPI of PL interrupt `line`."""
        if line >= self.irq_count:
            raise BuildError(f"{self.name} has {self.irq_count} interrupt lines from the PL; one more was asked for")
        return self._free[line]

    @property
    def _free(self) -> list[int]:
        return [spi for _, spi in self.irq_wires if spi not in self.taken]

    def spi_at(self, pin: str, index: int) -> int | None:
        """GIC SPI of bit `index` of a pin of the PS; None where it is not a shared interrupt (nFIQ, nIRQ)."""
        for name, lines, first in self.irq_pins:
            if name != pin:
                continue
            if index < lines:
                return first + index
            index -= lines
        return None


ZYNQ7000 = Platform(
    name="zynq7000",
    ps_ip="processing_system7",
    ps_cell="ps7",
    control_master="M_AXI_GP0",
    control_clock="M_AXI_GP0_ACLK",
    memory_slaves=("S_AXI_HP0", "S_AXI_HP1", "S_AXI_HP2", "S_AXI_HP3"),
    memory_clocks=("S_AXI_HP0_ACLK", "S_AXI_HP1_ACLK", "S_AXI_HP2_ACLK", "S_AXI_HP3_ACLK"),
    coherent_slaves=(),
    coherent_clocks=(),
    clock_pins=("FCLK_CLK0", "FCLK_CLK1", "FCLK_CLK2", "FCLK_CLK3"),
    reset_pin="FCLK_RESET0_N",
    # IRQ_F2P[7:0] are IRQ 61..68, [15:8] are 84..91; SPI is 32 less
    irq_pins=(("IRQ_F2P", 8, 29), ("IRQ_F2P", 8, 52)),
    base=0x4000_0000,
    size=0x4000_0000,
    address_bits=32,
    ultrascale=False,
    icap_rate_max=100_000_000,
    compatible="xlnx,zynq-7000",
)

ZYNQMP = Platform(
    name="zynqmp",
    ps_ip="zynq_ultra_ps_e",
    ps_cell="ps8",
    control_master="M_AXI_HPM0_FPD",
    control_clock="maxihpm0_fpd_aclk",
    memory_slaves=("S_AXI_HP0_FPD", "S_AXI_HP1_FPD", "S_AXI_HP2_FPD", "S_AXI_HP3_FPD"),
    memory_clocks=("saxihp0_fpd_aclk", "saxihp1_fpd_aclk", "saxihp2_fpd_aclk", "saxihp3_fpd_aclk"),
    coherent_slaves=("S_AXI_HPC0_FPD", "S_AXI_HPC1_FPD"),
    coherent_clocks=("saxihpc0_fpd_aclk", "saxihpc1_fpd_aclk"),
    clock_pins=("pl_clk0", "pl_clk1", "pl_clk2", "pl_clk3"),
    reset_pin="pl_resetn0",
    irq_pins=(("pl_ps_irq0", 8, 89), ("pl_ps_irq1", 8, 104)),
    base=0xA000_0000,
    size=0x1000_0000,
    address_bits=40,
    ultrascale=True,
    icap_rate_max=200_000_000,
    compatible="xlnx,zynqmp",
)


def platform_of(part: str) -> Platform:
    """Return the platform of a part. Raises BuildError for other families."""
    return ZYNQ7000 if "7z" in device_of(part) else ZYNQMP

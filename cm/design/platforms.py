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

Resources and configuration data of the parts that the advisor knows.

Resources, checked against public sources:

- xc7z010, xc7z020: LUTs, block RAMs, DSPs as cholla.mmto.org/fpga/gadgets.html has them; 2200 and 6650 CLBs of 16
  flip-flops each;
- xc7z045: block RAMs, the column "Available" of a published utilisation report;
- xczu3eg, xczu7ev: necst/faber_fpga, src/model/boards.py (Ultra96, ZCU104);
- xczu9eg: stanford-ppl/spatial, src/spatial/targets/xilinx/ZCU.scala (34 260 CLBs of 8 LUTs);
- xck26: LUTs, DSPs, block RAMs of raulest50/z-scan-propagation-kernel, .junie/kria_kv_260_resources.md; LUTs and
  flip-flops with the column "Available" of published utilisation reports; xczu5eg, xczu5ev are the same die, and of
  xczu5ev a published report has the same number of LUTs.

From memory of DS190, not checked: xc7z030, and LUTs, flip-flops and DSPs of xc7z045.

Bytes of a full bitstream, checked:

- Zynq-7000: u-boot, include/zynqpl.h (bits, divided by 8);
- xczu3eg, xczu7ev, xczu9eg: FreeBSD's zynqmp_fpga.c after UG1085 table 11-10; xczu7ev also by Vivado's own bitstream
  in alliedvision/zynq-mipi-bitstreams 4f0f401: 51 906 frames of 372 bytes and 2060 bytes beside them.

Not checked: xck26 and xczu5. Table 11-10 has 7 658 736 bytes for ZU4 and ZU5, not a whole number of frames beside
those 2060 bytes, as the other lengths are; 7 797 692 is (20 956 frames), and goes with the frames that a compressed
bitstream for K26 writes (Xilinx/kria-apps-firmware ebaef9a, kr260-gps-1588-ptp.bit: 4468 in row 0, 3072 of block RAM).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from cm.design.errors import BuildError


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

    @property
    def irq_count(self) -> int:
        """Interrupt lines from PL to PS."""
        return sum(lines for _, lines, _ in self.irq_pins)

    def spi(self, line: int) -> int:
        """GIC SPI of PL interrupt `line`."""
        for _, lines, first in self.irq_pins:
            if line < lines:
                return first + line
            line -= lines
        raise BuildError(f"{self.name} has {self.irq_count} interrupt lines from the PL; one more was asked for")

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


# device: LUT, FF, BRAM36, DSP, bytes of a full bitstream
PARTS = {
    "xc7z010": (17_600, 35_200, 60, 80, 2_083_740),
    "xc7z020": (53_200, 106_400, 140, 220, 4_045_564),
    "xc7z030": (78_600, 157_200, 265, 400, 5_979_916),
    "xc7z045": (218_600, 437_200, 545, 900, 13_321_404),
    "xczu3eg": (70_560, 141_120, 216, 360, 5_568_668),
    "xczu5eg": (117_120, 234_240, 144, 1_248, 7_797_692),
    "xczu5ev": (117_120, 234_240, 144, 1_248, 7_797_692),
    "xczu7ev": (230_400, 460_800, 312, 1_728, 19_311_092),
    "xczu9eg": (274_080, 548_160, 912, 2_520, 26_510_780),
    "xck26": (117_120, 234_240, 144, 1_248, 7_797_692),
}

# what there is, as Xilinx' selection guides list it; the rest of a name is package and speed grade
_ZYNQ = frozenset(["7s", "10", "12s", "14s", "15", "20", "30", "35", "45", "100"])
_ZYNQMP = {
    "cg": frozenset((1, 2, 3, 4, 5, 6, 7, 9)),
    "eg": frozenset((1, 2, 3, 4, 5, 6, 7, 9, 11, 15, 17, 19)),
    "ev": frozenset((4, 5, 7)),
    "dr": frozenset((21, 25, 27, 28, 29, 39, 42, 43, 46, 47, 48, 49, 63, 64, 65, 67)),
}
_KRIA = frozenset((24, 26))


def _exists(device: str) -> bool:
    """Whether a name that is spelled like a device's is one."""
    if zynq := re.fullmatch(r"x[caq]7z0*(\d+s?)", device):
        return zynq[1] in _ZYNQ
    if kria := re.fullmatch(r"xck(\d+)", device):
        return int(kria[1]) in _KRIA
    mpsoc = re.fullmatch(r"x[caq]zu(\d+)(eg|ev|cg|dr)", device)
    return mpsoc is not None and int(mpsoc[1]) in _ZYNQMP[mpsoc[2]]


def device_of(part: str) -> str:
    """Return the device of a full part name, such as ``xc7z020`` of ``xc7z020clg400-1``."""
    found = re.match(r"(x[caq]7z\d{3}s?|x[caq]zu\d+(?:eg|ev|cg|dr)|xck\d+)", part)
    if found is None:
        raise BuildError(f"{part} is not part of the Zynq-7000 or Zynq UltraScale+ family (like xc7z020clg400-1)")
    if not _exists(found.group(1)):
        raise BuildError(f"{part}: there is no device {found.group(1)} in the Zynq families")
    return found.group(1)


def platform_of(part: str) -> Platform:
    """Return the platform of a part. Raises BuildError for other families."""
    return ZYNQ7000 if "7z" in device_of(part) else ZYNQMP

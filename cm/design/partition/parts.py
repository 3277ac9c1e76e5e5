# SPDX-License-Identifier: Apache-2.0
"""Resources and configuration data of the parts that the advisor knows.

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

from cm.design.errors import BuildError
from cm.design.partition.model import Part
from cm.design.project.model import Resources

# device: LUT, FF, BRAM36, DSP, bytes of a full bitstream
_PARTS = {
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


def part_of(device: str) -> Part:
    """The part; BuildError lists those that are known."""
    if device not in _PARTS:
        raise BuildError(f"the resources of {device} are not known here (only {', '.join(_PARTS)})")
    lut, ff, bram, dsp, size = _PARTS[device]
    return Part(device, Resources(lut, ff, bram, dsp), size)

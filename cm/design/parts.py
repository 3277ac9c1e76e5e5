# SPDX-License-Identifier: Apache-2.0
"""Parts and their devices: which there are; resources and configuration data of those that the advisor knows.

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

from cm.design.errors import BuildError

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

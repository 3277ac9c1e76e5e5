# SPDX-License-Identifier: Apache-2.0
"""Resources and configuration data of the parts that the advisor knows.

Checked: the full bitstreams of Zynq-7000 with u-boot's include/zynqpl.h (bits, divided by 8); LUTs, flip-flops,
block RAMs (of 36 Kbit) and DSPs of xc7z020, LUTs and flip-flops of xck26, LUTs, flip-flops and block RAMs of xczu3eg
and block RAMs of xc7z045 with the column "Available" of published utilisation reports. All else is from memory of
DS190, DS891, DS987 and UG570 table 1-4, not checked (K26: bitstream about that of the ZU5EV).
"""

from __future__ import annotations

from cm.build.errors import BuildError
from cm.build.partition import Part
from cm.build.project import Resources

# device: LUT, FF, BRAM36, DSP, bytes of a full bitstream
_PARTS = {
    "xc7z010": (17_600, 35_200, 60, 80, 2_083_740),
    "xc7z020": (53_200, 106_400, 140, 220, 4_045_564),
    "xc7z030": (78_600, 157_200, 265, 400, 5_979_916),
    "xc7z045": (218_600, 437_200, 545, 900, 13_321_404),
    "xczu3eg": (70_560, 141_120, 216, 360, 5_568_668),
    "xczu9eg": (274_080, 548_160, 912, 2_520, 26_510_780),
    "xck26": (117_120, 234_240, 144, 1_248, 7_797_692),
}


def part_of(device: str) -> Part:
    """The part; BuildError lists those that are known."""
    if device not in _PARTS:
        raise BuildError(f"the resources of {device} are not known here (only {', '.join(_PARTS)})")
    lut, ff, bram, dsp, size = _PARTS[device]
    return Part(device, Resources(lut, ff, bram, dsp), size)

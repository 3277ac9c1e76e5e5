# SPDX-License-Identifier: Apache-2.0
"""Resources and configuration data of the parts that the advisor knows.

Sources: DS190 (Zynq-7000 overview), DS891 (Zynq UltraScale+ overview), DS987 (Kria K26); lengths of full
bitstreams from UG470 and UG570, table 1-1 and 1-4 (K26: about that of the ZU5EV). Block RAMs of 36 Kbit.
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

# SPDX-License-Identifier: Apache-2.0
"""Reads resources from the text of Vivado's ``report_utilization``.

It reads the tables of 7 series (``Slice LUTs``) and UltraScale+ (``CLB LUTs``), for a module synthesised out of
context and for a whole design. Rows are found by name and columns by heading, because the number of columns
differs between versions.

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
from collections.abc import Iterator
from pathlib import Path

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


_ROWS = {
    "Slice LUTs": "lut",
    "CLB LUTs": "lut",
    "Slice Registers": "ff",
    "CLB Registers": "ff",
    "Block RAM Tile": "bram",
    "DSPs": "dsp",
}
_LIMIT = 4 << 20  # bytes; real reports have some 10 KiB


def read_utilisation(path: Path) -> Resources:
    """Return the resources used. Raises BuildError, with the file's name, if it is not such a report."""
    try:
        if path.stat().st_size > _LIMIT:
            raise BuildError(f"{path} is not a utilisation report: it has {path.stat().st_size} bytes")
        return parse_utilisation(path.read_text(encoding="utf-8", errors="replace"), str(path))
    except OSError as error:
        raise BuildError(f"{path}: {error.strerror}") from None


def parse_utilisation(text: str, name: str = "report") -> Resources:
    """Read a report's text; `name` is used in messages. For each row the first table that has it counts."""
    found: dict[str, float] = {}
    for site, used in _used(text):
        key = _ROWS.get(site)
        if key is not None and key not in found:
            found[key] = _number(used, site, name)
    missing = [wanted for wanted in dict.fromkeys(_ROWS.values()) if wanted not in found]
    if missing:
        wanted = {"lut": "LUTs", "ff": "registers", "bram": "Block RAM Tile", "dsp": "DSPs"}
        rows = ", ".join(wanted[key] for key in missing)
        raise BuildError(f"{name} is not a report of report_utilization: no row for {rows} (-hierarchical has none)")
    return Resources(int(found["lut"]), int(found["ff"]), found["bram"], int(found["dsp"]))


def _used(text: str) -> Iterator[tuple[str, str]]:
    """Yield (site type, used) of every row below a heading that has both."""
    column = 0
    for line in text.splitlines():
        if not line.startswith("|"):
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if cells[0] == "Site Type":
            column = cells.index("Used") if "Used" in cells else 0
        elif column and column < len(cells):
            # an asterisk refers to a note below the table
            yield cells[0].rstrip("*").rstrip(), cells[column]


def _number(text: str, site: str, name: str) -> float:
    if not re.fullmatch(r"\d+(\.\d+)?", text, re.ASCII):
        raise BuildError(f"{name}: {site}: {text!r} is not a number of sites used")
    return float(text)

# SPDX-License-Identifier: Apache-2.0
"""Runs inside nextpnr before placement: fixes anchors in their places, and other cells to their areas.

`ctx` is nextpnr's. The job is a JSON file, which CM_OPEN_JOB names.
"""

import json
import os
from pathlib import Path

LOGIC = ("SLICE_", "CARRY", "SELMUX", "F7", "F8", "RAMB", "RAMD", "RAMS", "DSP", "SRL")

job = json.loads(Path(os.environ["CM_OPEN_JOB"]).read_text())

# The net that occupies wires this run must not use (block.py). A net without a driver is left alone by
# the routers; one without a user may have no wires.
ctx.createNet("cm_blocked")
ctx.cells["$PACKER_GND_DRV"].addInput("CM_BLOCKED")
ctx.connectPort("cm_blocked", "$PACKER_GND_DRV", "CM_BLOCKED")

areas = {name: frozenset(places) for name, places in job["areas"].items()}
for name in areas:
    ctx.createRectangularRegion(name, 0, 0, 0, 0)
at_place = {}
for name, places in areas.items():
    for place in places:
        at_place.setdefault(place, []).append(name)
for bel in ctx.getBels():
    tile, _, rest = bel.partition("/")
    site = tile + "/" + rest.partition(".")[0]
    for place in (tile, site):
        for name in at_place.get(place, ()):
            ctx.addBelToRegion(name, bel)


def own_area(name):
    """The area of a cell of the netlist, and of what it was packed into (`cell/DPR0`)."""
    while name not in job["own_areas"]:
        name, slash, _ = name.rpartition("/")
        if not slash:
            return None
    return job["own_areas"][name]


bels = dict(job["bels"])
placed = set()
for name, cell in ctx.cells:
    name = str(name)
    last = name.rpartition(".")[2]
    if last in bels:
        cell.setAttr("BEL", bels[last])
        placed.add(last)
    elif str(cell.type).startswith(LOGIC):
        area = next(area for prefix, area in job["cells"] if last.startswith(prefix))
        ctx.constrainCellToRegion(name, (str(cell.type) == "SLICE_LUTX" and own_area(name)) or area)
missing = sorted(set(bels) - placed)
if missing:
    raise RuntimeError("cells to be placed are not in the design: " + ", ".join(missing[:5]))

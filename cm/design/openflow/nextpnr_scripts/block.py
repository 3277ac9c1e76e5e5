# SPDX-License-Identifier: Apache-2.0
"""Runs inside nextpnr before routing: occupies the wires that this run must not use with a net without cells."""

import json
import os
from pathlib import Path

job = json.loads(Path(os.environ["CM_OPEN_JOB"]).read_text())

if job["blocked"]:
    nobody = ctx.nets["cm_blocked"]
    for wire in job["blocked"]:
        if ctx.checkWireAvail(wire):
            ctx.bindWire(wire, nobody, STRENGTH_LOCKED)


def tie(sink, net):
    """Bind the route from a tile's own constant to a pin, for which the router would search the whole device."""
    seen = {sink}
    ways = [(sink, ())]
    while ways:
        wire, pips = ways.pop(0)
        if wire.endswith("/GND_WIRE") or (pips and bound.get(wire)):
            if wire.endswith("/GND_WIRE") and not bound.get(wire):
                ctx.bindWire(wire, net, STRENGTH_LOCKED)
                bound[wire] = True
            for pip, target in reversed(pips):
                ctx.bindPip(pip, net, STRENGTH_LOCKED)
                bound[target] = True
            return True
        if len(pips) == DEPTH:
            continue
        for pip in ctx.getPipsUphill(wire):
            if not pip.rpartition("/")[2].startswith(TOWARDS_GROUND):
                continue
            source = ctx.getPipSrcWire(pip)
            if source not in seen and (bound.get(source) or ctx.checkWireAvail(source)):
                seen.add(source)
                ways.append((source, (*pips, (pip, wire))))
    return False


TOWARDS_GROUND = ("GND_WIRE", "GFAN", "FAN_", "IMUX", "CLK", "CTRL", "PS7_", "PSS", "INT_INTERFACE")
DEPTH = 8  # pips: into the processing system, its column, the interconnect tile, fans, the constant
bound = {}
ground = ctx.createNet("cm_ground")
tied = [
    (str(user.cell.name), str(user.port), ctx.getBelPinWire(str(user.cell.bel), str(user.port)))
    for user in ctx.nets["$PACKER_GND_NET"].users
    if str(user.cell.type) == "PS7_PS7"
]
for cell, port, pin in tied:  # pins with no short way (clocks) are left to the router
    if tie(pin, ground):
        # A separate net without a driver: router2 fails an assertion on a constant net that is partly routed.
        ctx.disconnectPort(cell, port)
        ctx.connectPort("cm_ground", cell, port)

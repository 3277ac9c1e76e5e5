# SPDX-License-Identifier: Apache-2.0
"""For nextpnr's --post-route: what its routed JSON does not say of nets, as routes.json.

`ways`: of each net, wires with the wire before each and the pip between; `users`: of each net, cells with the pin and
the wire at it; `beside`: for each pip in use, the other pips into its wire whose source carries a net, and which;
`standing`: the nets that come to pins of slices by wires that have only one pip into them, routed to them or not.
"""
# ruff: noqa: F821 - ctx is nextpnr's

import json
from pathlib import Path


def bound(wire):
    try:
        return str(ctx.getBoundWireNet(wire).name)
    except Exception:  # noqa: BLE001 - no net, which nextpnr says by a type of its own
        return ""


def standing(wire):
    while not (net := bound(wire)):
        up = list(map(str, ctx.getPipsUphill(wire)))
        if len(up) != 1:
            return ""
        wire = str(ctx.getPipSrcWire(up[0]))
    return net


ways, users, beside, stands = {}, {}, {}, {}
for name, net in ctx.nets:
    own = ways[str(name)] = []
    for wire, way in net.wires:
        try:
            pip, before = str(way.pip), str(ctx.getPipSrcWire(str(way.pip)))
        except Exception:  # noqa: BLE001 - the net's source has no pip
            continue
        own.append([str(wire), before, pip])
        others = {str(up): bound(ctx.getPipSrcWire(up)) for up in ctx.getPipsUphill(str(wire)) if str(up) != pip}
        beside[pip] = {up: there for up, there in others.items() if there}
    users[str(name)] = []
    for user in net.users:
        try:
            at = str(ctx.getBelPinWire(str(user.cell.bel), str(user.port)))
        except Exception:  # noqa: BLE001 - a pin without a wire
            continue
        users[str(name)].append([str(user.cell.name), str(user.port), at])
for slice_ in {str(cell.bel).partition(".")[0] for _, cell in ctx.cells if "/SLICE_" in str(cell.bel)}:
    for pin in ("AX", "BX", "CX", "DX", "AI", "BI", "CI", "DI", "CE", "SR", "WE"):
        try:
            net = standing(f"{slice_}.{pin}")
        except Exception:  # noqa: BLE001 - a slice without memory has no such pin
            continue
        if net:
            stands[f"{slice_}.{pin}"] = net
found = {"ways": ways, "users": users, "beside": beside, "standing": stands}
Path("routes.json").write_text(json.dumps(found))

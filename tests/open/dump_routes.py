# SPDX-License-Identifier: Apache-2.0
"""For nextpnr's --post-route: the way of each net, wire by wire with the wire before it, as routes.json."""
# ruff: noqa: F821 - ctx is nextpnr's

import json
from pathlib import Path

routes = {}
for name, net in ctx.nets:
    ways = routes[str(name)] = []
    for wire, way in net.wires:
        try:
            ways.append([str(wire), str(ctx.getPipSrcWire(str(way.pip))), str(way.pip)])
        except Exception:  # noqa: BLE001 - the net's source has no pip, which nextpnr says by a type of its own
            continue
Path("routes.json").write_text(json.dumps(routes))

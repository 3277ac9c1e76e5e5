# SPDX-License-Identifier: Apache-2.0
"""Runs inside nextpnr after routing: writes the place of each cell and the route of each net as JSON."""

import json
import os
from pathlib import Path

job = json.loads(Path(os.environ["CM_OPEN_JOB"]).read_text())

cells = {}
for name, cell in ctx.cells:
    cells[str(name)] = [str(cell.type), str(cell.bel)]

nets = {}
for name, net in ctx.nets:
    name = str(name)
    if name == "cm_blocked":
        continue
    driver = net.driver
    wires = {}
    for wire, way in net.wires:
        try:
            pip = str(way.pip)
            wires[str(wire)] = [pip, str(ctx.getPipSrcWire(pip))]
        except Exception:
            wires[str(wire)] = None  # the net's source
    users = []
    for user in net.users:
        bel = str(user.cell.bel)
        try:
            users.append([str(user.cell.name), str(user.port), str(ctx.getBelPinWire(bel, str(user.port)))])
        except Exception:
            users.append([str(user.cell.name), str(user.port), ""])
    try:
        source = str(driver.cell.name)
    except Exception:
        source = ""
    nets[name] = {"driver": source, "users": users, "wires": wires}

Path(job["result"]).write_text(json.dumps({"cells": cells, "nets": nets}))

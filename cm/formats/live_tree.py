# SPDX-License-Identifier: Apache-2.0
"""Overlays against the tree of the running kernel: what another node, to which a driver is bound, has already."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from cm.device.checks.machine import Machine
from cm.device.paths import Root
from cm.formats.fdt import FdtNode, read_folder
from cm.formats.tree_clashes import Clash, added, clashes

Overlays = Mapping[str, FdtNode]  # by name, in the order in which they are applied


def live_clashes(root: Root, overlays: Overlays, ours: Iterable[Overlays]) -> list[Clash]:
    """The clashes of overlays with the live tree below a root; none on a machine that is no Zynq.

    `ours`: overlays whose nodes count as free, as those go when others come.
    """
    machine = Machine(root)
    if machine.family is None:
        return []
    tree = read_folder(root.join("proc/device-tree"))
    idle = frozenset(device.node for device in machine.devices if not device.driver)
    return clashes(tree, overlays, idle.union(*(added(tree, others) for others in (overlays, *ours))))

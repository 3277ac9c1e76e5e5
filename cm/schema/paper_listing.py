# SPDX-License-Identifier: Apache-2.0
"""The form of the paper's Listing 1: lists of one-key maps instead of maps.

Its ``modes:`` has its modes as sibling keys, so that YAML reads a map whose first key has no value:

    - modes:
      edge_detection: …

and an overlay may be among the entries of ``mmio``. Functions here return new trees, since an
alias may have put one node in several places.
"""

from __future__ import annotations

from cm.schema.tree import Entry, Items, Node, Scalar, Table


def fold(items: Items, names: bool) -> Node:
    """A list of maps as one map; with `names`, a bare name is a key without a value.

    Anything else is returned as it is.
    """
    table = Table(items.mark)
    for item in items.items:
        if isinstance(item, Table):
            adopted = _adopt_siblings(item)
            for key, entry in adopted.entries.items():
                table.add(key, entry)
            table.duplicates += adopted.duplicates
        elif names and isinstance(item, Scalar) and isinstance(item.value, str):
            table.add(item.value, Entry(item.mark, Scalar(None, item.mark, "")))
        else:
            return items
    return table


def _adopt_siblings(table: Table) -> Table:
    """`table`; if its first key has no value, the keys after it become its value."""
    if len(table.entries) < 2:
        return table
    (first, entry), *rest = table.entries.items()
    if not (isinstance(entry.node, Scalar) and entry.node.value is None):
        return table
    inner = Table(entry.mark, dict(rest), [twice for twice in table.duplicates if twice[0] != first])
    outer = [twice for twice in table.duplicates if twice[0] == first]
    return Table(table.mark, {first: Entry(entry.mark, inner)}, outer)


def windows(node: Node) -> Node:
    """A list of register windows, from one map, from maps, or from one-key maps one after the other."""
    if isinstance(node, Table):
        return Items(node.mark, [node])
    if not isinstance(node, Items):
        return node
    result = Items(node.mark)
    current: Table | None = None
    for item in node.items:
        item = _adopt_siblings(item) if isinstance(item, Table) else item
        if not isinstance(item, Table) or len(item.entries) != 1:
            result.items.append(item)
            current = None
            continue
        ((key, entry),) = item.entries.items()
        if current is None or key in current.entries:
            current = Table(item.mark)
            result.items.append(current)
        current.add(key, entry)
        current.duplicates += item.duplicates
    return result


def lift_overlays(table: Table) -> Table:
    """`table` with all overlays under ``overlays``: those of ``overlay``, and those inside ``mmio``."""
    result = Table(table.mark, dict(table.entries), list(table.duplicates))
    if "overlay" in result.entries:
        entry = result.entries.pop("overlay")
        result.add("overlays", entry)
    if "mmio" in result.entries:
        _lift_from_windows(result)
    return result


def _lift_from_windows(table: Table) -> None:
    mmio = table.entries["mmio"]
    if not isinstance(mmio.node, Items):
        return
    kept = Items(mmio.node.mark)
    for item in mmio.node.items:
        rest = item
        if isinstance(item, Table):
            rest = Table(item.mark, dict(item.entries), item.duplicates)
            for key in ("overlay", "overlays"):
                if key in rest.entries:
                    _append_overlays(table, rest.entries.pop(key))
            if not rest.entries and item.entries:
                continue
        kept.items.append(rest)
    table.entries["mmio"] = Entry(mmio.mark, kept)


def _append_overlays(table: Table, entry: Entry) -> None:
    """Add the overlays of `entry` after those that `table` has."""
    before = table.entries.get("overlays")
    nodes = [before.node, entry.node] if before else [entry.node]
    items: list[Node] = []
    for node in nodes:
        items += node.items if isinstance(node, Items) else [node]
    mark = before.mark if before else entry.mark
    table.entries["overlays"] = Entry(mark, Items(entry.mark, items))

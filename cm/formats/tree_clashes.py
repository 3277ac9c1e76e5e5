# SPDX-License-Identifier: Apache-2.0
"""Whether overlays and a board's tree ask for the same: interrupts, register windows, clocks, and labels that lack.

An overlay that clashes is applied all the same, and the kernel says so; only a driver's probe fails. What a driver does
with an interrupt or a window was read in Linux 6.1 and 6.12: xilinx_dma shares its interrupts, uio_pdrv_genirq asks for
them unshared and only maps its window (so does cm_window, which goes on without; cm_intc maps status registers of
engines), all others request both.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import pairwise, product

from cm.formats.fdt import FdtError, FdtNode
from cm.formats.fdt_overlay import apply, missing_labels, symbols_of
from cm.frozen import dataclass

_SHARES = ("xlnx,axi-dma-", "xlnx,axi-vdma-", "xlnx,axi-cdma-", "xlnx,axi-mcdma-")
_ONLY_MAPS = ("generic-uio", "fpga-cm,uio", "fpga-cm,window", "fpga-cm,polled-intc")

Line = tuple[str, tuple[int, ...], int]  # an interrupt: path of its controller, its cells but the last, its flags


@dataclass(frozen=True, slots=True)
class Clash:
    """`kind`: irq, window, label, clock. `node` is the overlay's, or the overlay itself; `holder` is the tree's."""

    kind: str
    node: str
    holder: str
    text: str
    advice: str


def clashes(base: FdtNode, overlays: Mapping[str, FdtNode], idle: Collection[str] = ()) -> list[Clash]:
    """What overlays (by name, in the order in which they are applied) would meet on a tree.

    `idle`: paths of nodes that hold nothing, as no driver is bound to them.
    """
    tree, paths = base, set[str]()
    for name, overlay in overlays.items():
        if lacking := missing_labels(tree, overlay):
            return [_label(name, lacking, bool(symbols_of(tree)))]
        try:
            applied = apply(tree, overlay)
        except FdtError as error:
            return [Clash("label", name, "", f"{name}: {error}", "apply the overlay that brings it first")]
        tree, paths = applied.root, paths | applied.paths
    return list(_Tree(tree).clashes(paths, idle))


def added(base: FdtNode, overlays: Mapping[str, FdtNode]) -> frozenset[str]:
    """The paths that overlays name on a tree, as far as they can be applied to it."""
    tree, paths = base, frozenset[str]()
    for overlay in overlays.values():
        with suppress(FdtError):
            applied = apply(tree, overlay)
            tree, paths = applied.root, paths | applied.paths
    return paths


def _label(overlay: str, lacking: Sequence[str], any_there: bool) -> Clash:
    if any_there:
        text = f"{overlay}: the tree has no label {', '.join(lacking)}"
        return Clash("label", overlay, "", text, "use the kernel's own tree of the board, or add the labels to yours")
    text = f"{overlay}: the tree has no __symbols__, so no overlay that names a label is taken (-EINVAL)"
    return Clash("label", overlay, "", text, "build the board's tree with dtc -@ (DTC_FLAGS, EXTRA_DTC_ARGS)")


class _Tree:
    def __init__(self, root: FdtNode) -> None:
        self._nodes = {path: node for path, node in root.walk() if not path.startswith("/__")}

    def clashes(self, ours: Collection[str], idle: Collection[str]) -> Iterator[Clash]:
        new = [path for path in self._nodes if path in ours and self._enabled(path)]
        held = [path for path in self._nodes if self._enabled(path) and path not in idle]
        lines = {path: self.interrupts(path) for path in {*new, *held}}
        windows = {path: self.windows(path) for path in lines}
        seen: set[frozenset[str]] = set()
        for one, other in product(new, held):
            pair = frozenset((one, other))
            if pair in seen or _within(one, other) or _within(other, one):
                continue
            seen.add(pair)
            for a, b in product(lines[one], lines[other]):
                shared = a[2] == b[2] and self._is(one, _SHARES) and self._is(other, _SHARES)
                if a[:2] == b[:2] and not shared:
                    yield self._clash("irq", one, other, f"interrupt {' '.join(map(str, a[1]))} of {a[0]}")
            for (start, size), (start_b, size_b) in product(windows[one], windows[other]):
                mapped = self._is(one, _ONLY_MAPS) or self._is(other, _ONLY_MAPS)
                if start < start_b + size_b and start_b < start + size and not mapped:
                    yield self._clash("window", one, other, f"registers at {max(start, start_b):#x}")
        for path in new:
            for wrong in sorted(self._wrong_clocks(path)):
                advice = "use the kernel's own tree of the board, or enable the clock's node"
                yield Clash("clock", path, "", f"{path}: {wrong}", advice)

    def _clash(self, kind: str, node: str, holder: str, what: str) -> Clash:
        device = self.device(holder)
        text = f"{what}: {node} asks for what {holder} ({self._first_compatible(holder)}) has"
        if self._is(holder, ("generic-uio",)):
            free = f"echo {device} >/sys/bus/platform/drivers/uio_pdrv_genirq/unbind, before the overlay is applied"
            return Clash(kind, node, holder, text, f"{free}; or give the design another interrupt (board: of cm build)")
        advice = (
            "the board's tree, or an application that is loaded, describes the PL too: xmutil unloadapp, 'Remove PL "
            f"from device tree' in PetaLinux, or echo {device} >/sys/bus/platform/devices/{device}/driver/unbind"
        )
        return Clash(kind, node, holder, text, advice)

    def device(self, path: str) -> str:
        """A node's name as a device of the platform bus."""
        name, windows = path.rpartition("/")[2].partition("@")[0], self.windows(path)
        return f"{windows[0][0]:x}.{name}" if windows else name

    def interrupts(self, path: str) -> list[Line]:
        """Those of a node."""
        node, found = self._nodes[path], list[tuple[str, list[int]]]()
        if cells := _cells(node, "interrupts-extended"):
            while cells and (on := self._handles.get(cells[0])):
                count = self._cell(on, "#interrupt-cells", 1)
                found.append((on, cells[1 : 1 + count]))
                cells = cells[1 + count :]
        elif (cells := _cells(node, "interrupts")) and (controller := self._controller(path)):
            count = self._cell(controller, "#interrupt-cells", 1)
            found = [(controller, cells[i : i + count]) for i in range(0, len(cells), count)]
        return [(on, tuple(c[:-1] or c), c[-1] & 0xFF if len(c) > 1 else 0) for on, c in found]

    def _controller(self, path: str) -> str | None:
        for above in _up(path):
            if "interrupt-parent" in self._nodes[above].properties:
                return self._handles.get(self._cell(above, "interrupt-parent"))
            if above != path and "#interrupt-cells" in self._nodes[above].properties:
                return above
        return None

    def windows(self, path: str) -> list[tuple[int, int]]:
        """Each range of a node's registers as the processors see it; none where a bus on the way maps nothing."""
        _, *above = _up(path)
        if not above or "reg" not in self._nodes[path].properties:
            return []
        address, size = self._cell(above[0], "#address-cells", 2), self._cell(above[0], "#size-cells", 1)
        found = [(entry[0], entry[1]) for entry in _entries(_cells(self._nodes[path], "reg"), address, size)]
        for bus, outer in pairwise(above):
            if "ranges" not in self._nodes[bus].properties:
                return []
            own, out = self._cell(bus, "#address-cells", 2), self._cell(outer, "#address-cells", 2)
            maps = list(_entries(_cells(self._nodes[bus], "ranges"), own, out, self._cell(bus, "#size-cells", 1)))
            if maps:
                found = [(at - c + to, n) for at, n in found for c, to, most in maps if 0 <= at - c < most]
        return [(at, size) for at, size in found if size]

    def _wrong_clocks(self, path: str) -> set[str]:
        wrong = set[str]()
        for name in ("clocks", "assigned-clocks"):
            cells = _cells(self._nodes[path], name)
            while cells:
                on = self._handles.get(cells[0])
                if on is None or "#clock-cells" not in self._nodes[on].properties:
                    wrong.add(f"{name}: {cells[0]:#x} is no clock")
                    break
                count, outputs = self._cell(on, "#clock-cells"), _strings(self._nodes[on], "clock-output-names")
                if not self._enabled(on):
                    wrong.add(f"{name}: {on} is disabled")
                if count and outputs and cells[1] >= len(outputs):
                    wrong.add(f"{name}: {on} has no output {cells[1]}")
                cells = cells[1 + count :]
        return wrong

    @cached_property
    def _handles(self) -> Mapping[int, str]:
        return {self._cell(path, "phandle"): path for path, node in self._nodes.items() if "phandle" in node.properties}

    def _enabled(self, path: str) -> bool:
        return all((_strings(self._nodes[p], "status") or ["okay"])[0] in ("okay", "ok") for p in _up(path))

    def _is(self, path: str, prefixes: tuple[str, ...]) -> bool:
        return any(name.startswith(prefixes) for name in _strings(self._nodes[path], "compatible"))

    def _first_compatible(self, path: str) -> str:
        return (_strings(self._nodes[path], "compatible") or ["no compatible string"])[0]

    def _cell(self, path: str, name: str, default: int = 0) -> int:
        return (_cells(self._nodes[path], name) or [default])[0]


def _up(path: str) -> list[str]:
    """A path and those above it."""
    found = [path]
    while found[-1] != "/":
        found.append(found[-1].rpartition("/")[0] or "/")
    return found


def _within(path: str, other: str) -> bool:
    return path in _up(other)


def _cells(node: FdtNode, name: str) -> list[int]:
    value = node.properties.get(name, b"")
    return [cell for (cell,) in struct.iter_unpack(">I", value[: len(value) & ~3])]


def _entries(cells: Sequence[int], *widths: int) -> Iterator[list[int]]:
    """Numbers of `widths` cells each, again and again."""
    step = sum(widths)
    for at in range(0, len(cells) - step + 1 if step else 0, step):
        row, rest = list[int](), list(cells[at : at + step])
        for width in widths:
            row.append(int.from_bytes(struct.pack(f">{width}I", *rest[:width]), "big"))
            rest = rest[width:]
        yield row


def _strings(node: FdtNode, name: str) -> list[str]:
    return [part.decode("ascii", "replace") for part in node.properties.get(name, b"").split(b"\0") if part]

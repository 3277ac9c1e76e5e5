# SPDX-License-Identifier: Apache-2.0
"""For nextpnr's --pre-place: anchors at their places, the module in a rectangle."""
# ruff: noqa: F821 - ctx is nextpnr's

ctx.createRectangularRegion("module", 84, 15, 97, 45)
for name, cell in ctx.cells:
    text = str(name)
    if text.startswith("anchors["):
        number, _, kind = text.removeprefix("anchors[").partition("].")
        if kind in ("enters", "leaves"):
            column = 84 if kind == "enters" else 87
            cell.setAttr("BEL", f"X{column}Y{12 + int(number) // 4}/SLICE_X0Y0.{'ABCD'[int(number) % 4]}6LUT")
    elif cell.type in ("SLICE_LUTX", "SLICE_FFX", "CARRY4"):
        ctx.constrainCellToRegion(text, "module")

# SPDX-License-Identifier: Apache-2.0
"""A region's frames as a picture: columns, what is configured where, and what is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TypeAlias
from xml.sax.saxutils import escape, quoteattr

from cm.formats.xray import Database, DatabaseMissing
from cm.formats.xray.fabric import ROWS, SWITCHES, FabricColumn, kind_by_frames, named, row_of
from cm.wire.messages.status import RegionMap

WITHOUT_DATABASE = (
    "Project X-Ray's database is not here (cm build tools --fetch brings it): columns are told by their number of "
    "frames, and tiles have no names."
)
_MARGIN, _GAP = 16, 10
_CELL, _CLOCK = 5, 4  # heights of a row of tiles and of the clock row
_BAR = 30  # of the strip of frames
_HEAD = 52  # above the tiles of a column: its kind, in two lines, and its number
_SWITCHES, _LOGIC, _CLOCKS, _WRONG, _INK, _PALE = "#1b62a5", "#22803a", "#8a5a00", "#d4001a", "#1d2430", "#f2f4f7"
_COLOURS = {
    _SWITCHES: "switches",
    _LOGIC: "logic",
    _CLOCKS: "clock row",
    _INK: "bits of a frame",
    _WRONG: "wrong",
}

Wrong: TypeAlias = Mapping[
    int, Iterable[int]
]  # frame address → words that are wrong, empty where only the frame is known


def region_picture(found: RegionMap, columns: Sequence[FabricColumn], wrong: Wrong, is_named: bool) -> str:
    """Return an SVG document of a region; `is_named`: whether the database's kinds and names are in `columns`."""
    return svg(columns, title(found), wrong, "" if is_named else WITHOUT_DATABASE, [summary(found, columns, wrong)])


def title(found: RegionMap) -> str:
    """What is drawn."""
    return f"Region {found.region} of {found.config_name}: {found.module}"


def summary(found: RegionMap, columns: Sequence[FabricColumn], wrong: Wrong) -> str:
    """Device and counts, in a line."""
    frames, bits = sum(len(one.bits) for one in columns), sum(sum(one.bits) for one in columns)
    return f"{found.device}, {frames} frames with {bits} bits set, {_compared(found, wrong)}"


def _compared(found: RegionMap, wrong: Wrong) -> str:
    by = f" by the check {found.checked:.0f} s ago" if found.checked else ""
    if wrong:
        return f"{len(wrong)} of them wrong{by}"
    return f"none of them wrong{by}" if by else "not compared yet"


def wrong_words(frames: Iterable[tuple[int, Iterable[int]]]) -> Wrong:
    """What is to be red, from frame addresses and bits that differ (32 times the word, and the bit in it)."""
    return {far: sorted({bit // 32 for bit in bits}) for far, bits in frames}


def columns_of(found: RegionMap) -> tuple[FabricColumn, ...]:
    """What a manager told of a region's columns, to be drawn."""
    return tuple(
        FabricColumn(one.far, kind_by_frames(one.far, len(one.bits)), one.bits, one.switches, one.logic, one.clock)
        for one in found.columns
    )


def with_names(device: str, columns: Sequence[FabricColumn]) -> Sequence[FabricColumn] | None:
    """Columns with what the database says of them; None where it is not installed, or does not have the device."""
    try:
        return named(columns, Database.open(device))
    except DatabaseMissing:
        return None


def svg(
    columns: Sequence[FabricColumn], title: str, wrong: Wrong | None = None, remark: str = "", lines: Sequence[str] = ()
) -> str:
    """Return an SVG document. It has no styles and no scripts, so that a page may show it whatever its policy is.

    `wrong` are shown red; `lines` stand below the title, `remark` at the end.
    """
    bad = {address: tuple(words) for address, words in (wrong or {}).items()}
    bands = list(_bands(columns))
    top = 34 + 16 * len(lines)
    height = top + sum(_band_height() for _ in bands) + 44 + (16 if remark else 0)
    width = max([460, *(_band_width(band) for _, band in bands)]) + 2 * _MARGIN
    parts = [_text(_MARGIN, 24, title, 15, "600")]
    parts += [_text(_MARGIN, 42 + 16 * number, line) for number, line in enumerate(lines)]
    for label, band in bands:
        parts += _band(label, band, top, bad)
        top += _band_height()
    parts += _legend(top + 8)
    if remark:
        parts += _wrapped(remark, top + 44, width)
    more = 15 * (len(_split(remark, width)) - 1) if remark else 0
    start = f'<svg xmlns="http://www.w3.org/2000/svg" role="img" width="{width:g}" height="{height + more}"'
    start += f' viewBox="0 0 {width:g} {height + more}" font-family="sans-serif">'
    paper = _rect(0, 0, width, height + more, "#ffffff")
    return "\n".join([start, f"<title>{escape(title)}</title>", paper, *parts, "</svg>\n"])


def _bands(columns: Sequence[FabricColumn]) -> Iterator[tuple[str, list[FabricColumn]]]:
    """Columns of one row of one block type, with its name."""
    for key in sorted({(column.block_type, column.row) for column in columns}):
        half = "bottom" if key[1] & 32 else "top"
        what = "contents of block RAM, " if key[0] else ""
        own = [column for column in columns if (column.block_type, column.row) == key]
        yield f"{what}row {key[1] & 31} of the {half} half", own


def _scale(column: FabricColumn) -> float:
    """Width of a frame: each column is wide enough for its name."""
    return 0.75 if len(column.bits) > 64 else max(2.0, 76 / len(column.bits))


def _band_width(band: Sequence[FabricColumn]) -> float:
    return sum(len(column.bits) * _scale(column) + _GAP for column in band)


def _band_height() -> int:
    return 20 + _HEAD + ROWS * _CELL + _CLOCK + 6 + _BAR + 22


def _band(label: str, band: Sequence[FabricColumn], top: int, wrong: Mapping[int, tuple[int, ...]]) -> Iterator[str]:
    yield _text(_MARGIN, top + 14, label, weight="600")
    most = {
        "switches": max((max(column.switches) for column in band), default=0),
        "logic": max((max(column.logic) for column in band), default=0),
        "frame": max((max(column.bits) for column in band), default=0),
    }
    left: float = _MARGIN
    for column in band:
        yield from _column(column, left, top + 20, most, wrong)
        left += len(column.bits) * _scale(column) + _GAP


def _column(
    column: FabricColumn, left: float, top: int, most: Mapping[str, int], wrong: Mapping[int, tuple[int, ...]]
) -> Iterator[str]:
    scale = _scale(column)
    width, tiles = len(column.bits) * scale, top + _HEAD
    split = 0.0 if column.block_type else min(SWITCHES, len(column.bits)) * scale
    for number, words in enumerate(_two_lines(column.kind)):
        yield _text(left, top + 12 + 14 * number, words)
    yield _text(left, top + 44, f"column {column.number}")
    yield _rect(left, tiles, width, ROWS * _CELL + _CLOCK, _PALE)
    bad_rows = _wrong_rows(column, wrong)
    for row in range(ROWS):
        y = tiles + (ROWS - 1 - row) * _CELL + (_CLOCK if row < ROWS // 2 else 0)
        name = column.names[row] if column.names else f"row {row}"
        told = f"{name}: {column.switches[row]} bits of switches, {column.logic[row]} of logic"
        if column.block_type:
            told = f"{name}: {column.logic[row]} bits"
        if row in bad_rows:
            yield _rect(left, y, width, _CELL - 1, _WRONG, title=f"{told}; wrong in {', '.join(bad_rows[row])}")
            continue
        if column.switches[row]:
            yield _rect(left, y, split, _CELL - 1, _SWITCHES, _share(column.switches[row], most["switches"]), told)
        if column.logic[row]:
            share = _share(column.logic[row], most["logic"])
            yield _rect(left + split, y, width - split, _CELL - 1, _LOGIC, share, told)
    if column.clock:
        yield _rect(left, tiles + ROWS // 2 * _CELL, width, _CLOCK - 1, _CLOCKS, 1, f"clock row: {column.clock} bits")
    yield from _strip(column, left, tiles + ROWS * _CELL + _CLOCK + 6, most["frame"], wrong)


def _strip(
    column: FabricColumn, left: float, top: int, most: int, wrong: Mapping[int, tuple[int, ...]]
) -> Iterator[str]:
    """Each frame as a bar, as high as it has set bits; one that is wrong is red, and as high as can be."""
    scale = _scale(column)
    yield _rect(left, top, len(column.bits) * scale, _BAR, _PALE)
    for minor, bits in enumerate(column.bits):
        bad = column.address + minor in wrong
        high = _BAR if bad else round(_BAR * (bits / most) ** 0.5) if most else 0
        if high:
            colour = _WRONG if bad else _INK
            told = f"frame {column.address + minor:08X}: {bits} bits{', wrong' if bad else ''}"
            yield _rect(left + minor * scale, top + _BAR - high, scale * 0.8, high, colour, title=told)
    yield _text(left, top + _BAR + 14, f"{len(column.bits)} frames")


def _wrong_rows(column: FabricColumn, wrong: Mapping[int, tuple[int, ...]]) -> Mapping[int, list[str]]:
    """The rows of tiles with a word that is wrong, with the frames."""
    found: dict[int, list[str]] = {}
    for minor in range(len(column.bits)):
        address = column.address + minor
        for row in {row_of(word) for word in wrong.get(address, ())} - {None}:
            assert row is not None
            found.setdefault(row, []).append(f"frame {address:08X}")
    return found


def _legend(top: int) -> Iterator[str]:
    left = float(_MARGIN)
    for colour, words in _COLOURS.items():
        yield _rect(left, top, 12, 12, colour)
        yield _text(left + 17, top + 11, words)
        left += 36 + 7 * len(words)


def _share(bits: int, most: int) -> float:
    return 0.2 + 0.8 * (bits / most) ** 0.5 if most else 0


def _two_lines(words: str) -> Sequence[str]:
    if len(words) <= 13:
        return [words]
    cut = words.rfind(" ", 0, 14)
    return [words[:cut], words[cut + 1 :]] if cut > 0 else [words]


def _split(words: str, width: float) -> Sequence[str]:
    lines = [""]
    for word in words.split():
        if len(lines[-1]) + len(word) > (width - 2 * _MARGIN) / 6.5:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def _wrapped(words: str, top: float, width: float) -> Iterator[str]:
    for number, line in enumerate(_split(words, width)):
        yield _text(_MARGIN, top + 15 * number, line)


def _text(x: float, y: float, words: str, size: int = 12, weight: str = "400") -> str:
    place = f'x="{x:g}" y="{y:g}" font-size="{size}" font-weight="{weight}" fill="{_INK}"'
    return f"<text {place}>{escape(words)}</text>"


def _rect(x: float, y: float, width: float, height: float, fill: str, opacity: float = 1, title: str = "") -> str:
    shade = f' fill-opacity="{opacity:.2f}"' if opacity != 1 else ""
    place = f'x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill={quoteattr(fill)}{shade}'
    return f"<rect {place}><title>{escape(title)}</title></rect>" if title else f"<rect {place}/>"

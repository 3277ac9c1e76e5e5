# SPDX-License-Identifier: Apache-2.0
"""Bitstreams that a flow produced, checked and sorted into regions by the frames that they write.

Checks that bitstreams belong to one locked static part, and that it is the present one.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.plan.system import System
from cm.formats.bitstream import Container, Report, convert, footprint_of, inspect
from cm.formats.bitstream.verify import Expectation, refusals
from cm.schema.model import FrameRange

ALIKE = 0.5  # the smallest share of columns that two modules of one region have in common


@dataclass(frozen=True, slots=True)
class Image:
    """A bitstream and the result of its inspection."""

    path: Path
    report: Report

    @property
    def name(self) -> str:
        """The module's name: that of the file without its endings."""
        return self.path.name.removesuffix(".bin").removesuffix(".bit")

    @property
    def columns(self) -> frozenset[tuple[int, int, int]]:
        """Block type, row and column of the logic and block RAM that it writes.

        Every partial bitstream of 7-series writes block type 2 too, which belongs to no place of the device.
        """
        items = self.report.footprint
        return frozenset((item.block_type, item.row, item.column) for item in items if item.block_type <= 1)


def read_images(paths: Iterable[Path]) -> list[Image]:
    """Inspect bitstreams; of a .bit and a .bin of the same name, the .bit is used, because it contains more."""
    by_name: dict[tuple[Path, str], Path] = {}
    for path in sorted(paths, key=lambda path: (path.suffix != ".bit", path.name)):
        name = path.name.removesuffix(".bin").removesuffix(".bit")
        by_name.setdefault((path.parent, name), path)
    return [Image(path, inspect(path)) for path in sorted(by_name.values())]


def check_images(images: Sequence[Image], device: str | None) -> None:
    """BuildError with every reason not to use one of them."""
    wrong = []
    for image in images:
        expect = Expectation(device=device, allow_encrypted=True)
        wrong += [f"{image.path.name}: {refusal.message}" for refusal in refusals(image.report, expect)]
    devices = {image.report.device for image in images if image.report.device}
    if len(devices) > 1:
        wrong.append(f"bitstreams for different devices: {', '.join(sorted(devices))}")
    if wrong:
        raise BuildError("\n".join(wrong))


def check_different(images: Iterable[Image]) -> None:
    """Raise BuildError if two modules have the same bitstream: each contains the identity of its module."""
    first: dict[str, Image] = {}
    for image in images:
        other = first.setdefault(image.report.sha256, image)
        if other is not image:
            raise BuildError(f"{other.path.name} and {image.path.name} are the same bitstream: one is not its module's")


def likeness(one: Image, other: Image) -> float:
    """The columns that both write as a share of those that either writes; 1 for modules of one region."""
    union = one.columns | other.columns
    return len(one.columns & other.columns) / len(union) if union else 0.0


def by_region(images: Sequence[Image]) -> list[list[Image]]:
    """Partial bitstreams in groups that write the same columns, in the order of their names."""
    groups: list[list[Image]] = []
    for image in images:
        home = next((group for group in groups if all(likeness(image, other) >= ALIKE for other in group)), None)
        if home is None:
            groups.append([image])
        else:
            home.append(image)
    return groups


def check_regions(groups: dict[str, list[Image]]) -> list[str]:
    """Raise BuildError if modules of a region differ or regions overlap; returns warnings.

    A column that two regions touch is legal on UltraScale+, where a region's last row may hold a neighbour's edge, so
    this is only a warning.
    """
    wrong, warnings = [], []
    for name, images in groups.items():
        for image in images[1:]:
            if likeness(images[0], image) < ALIKE:
                wrong.append(f"{images[0].path.name} and {image.path.name} of {name} write different columns")
    names = list(groups)
    for index, one in enumerate(names):
        for other in names[index + 1 :]:
            first, second = (frozenset().union(*(i.columns for i in groups[name])) for name in (one, other))
            common = first & second
            if common and len(common) >= ALIKE * min(len(first), len(second)):
                wrong.append(f"{one} and {other} write the same frames: their bitstreams are of one region")
            elif common:
                warnings.append(f"{one} and {other} both write {len(common)} of {len(first | second)} columns")
    if wrong:
        raise BuildError("\n".join(wrong))
    return warnings


def footprint(images: Sequence[Image]) -> tuple[FrameRange, ...]:
    """The frames that a region owns, as its modules show it."""
    rows: dict[tuple[int, int], tuple[int, int]] = {}
    for image in images:
        for area in footprint_of(image.report):
            key = (area.block_type, area.row)
            first, last = rows.get(key, (area.column_first, area.column_last))
            rows[key] = min(first, area.column_first), max(last, area.column_last)
    return tuple(FrameRange(block, row, first, last) for (block, row), (first, last) in sorted(rows.items()))


def to_bin(image: Image) -> bytes:
    """Return the words in the byte order in which PCAP and a DMA-fed ICAP read them."""
    return convert(image.path, Container.BIN_SWAPPED)


_IN_VERILOG = re.compile(r"\.STATIC_ID\(32'h([0-9A-Fa-f]{8})\)")


def user_id_of(images: Sequence[Image], generated: Path) -> tuple[int | None, list[str]]:
    """Return the USERID of the flow that made `images`, with notes; None if their headers have none.

    Raises BuildError if they belong to several, or not to the locked static part below `generated`, if there is one.
    """
    told = {image.path.name: image.report.user_id for image in images if image.report.header}
    groups: dict[int | None, list[str]] = {}
    for name, user_id in told.items():
        groups.setdefault(user_id, []).append(name)
    if len(groups) > 1:
        each = "; ".join(f"{_shown(user_id)}: {', '.join(names)}" for user_id, names in groups.items())
        raise BuildError(f"bitstreams of several runs of the flow, by their USERID: {each}")
    found = next(iter(groups), None)
    checkpoint = generated / "checkpoints/static_routed.dcp"
    if told and checkpoint.is_file() and found != (expected := user_id_from(checkpoint)):
        raise BuildError(
            f"bitstreams of another static part: their USERID is {_shown(found)}, {checkpoint} gives {expected:08X}"
        )
    return found, _notes(images, found)


def user_id_from(checkpoint: Path) -> int:
    """Compute the USERID from the checkpoint of the locked static part, as the flow's ``cm_user_id`` does."""
    value = int.from_bytes(hashlib.sha256(checkpoint.read_bytes()).digest()[:4], "big")
    return min(value, 0xFFFF_FFFE)  # all ones: not set


def check_generated(system: System, generated: Path) -> None:
    """BuildError if the generated static part does not have the identity that the build schema gives."""
    path = generated / "hdl/cm_static.v"
    found = _IN_VERILOG.search(path.read_text(encoding="utf-8")) if path.is_file() else None
    if found and int(found[1], 16) != system.static_identity:
        raise BuildError(
            f"{path} is of another static part: its identity is {int(found[1], 16):#010x}, "
            f"{system.project.source.name} and its files give {system.static_identity:#010x}: "
            "cm build generate, then run the flow"
        )


def _notes(images: Sequence[Image], found: int | None) -> list[str]:
    silent = [image.path.name for image in images if not image.report.header]
    notes = [f"{', '.join(silent)}: no header, so the run that made it is not known"] if silent else []
    if found is None and len(silent) < len(images):
        notes.append("the bitstreams have no USERID: whether they share a locked static part is not known")
    return notes


def _shown(user_id: int | None) -> str:
    return "none" if user_id is None else f"{user_id:08X}"

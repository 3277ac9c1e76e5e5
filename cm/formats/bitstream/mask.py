# SPDX-License-Identifier: Apache-2.0
"""Which bits of a region's frames the fabric itself changes, and are not compared when they are read back.

These are the contents of block RAM, look-up tables that are memories or shift registers, and where a capture was made
the values of flip-flops. Vivado writes them as ``.msk`` (`write_bitstream -mask_file`, UG470 "Verifying Readback
Data"): a file of the bitstream's own form in which a 1 says "do not compare". Where there is none, Project X-Ray's
database knows them for 7-series. Without either the frames of block RAM's contents are left out, and the others are
compared as they are, as far as nothing says that a design has such look-up tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path

from cm.errors import CmError
from cm.formats.bitstream.container import open_image
from cm.formats.bitstream.errors import WrongDevice
from cm.formats.bitstream.geometry import decode_far, frame_order
from cm.formats.bitstream.idcodes import REVISION_MASK, Device, Family
from cm.formats.bitstream.inspect import inspect
from cm.formats.bitstream.memory import frames_of
from cm.frozen import dataclass

Masks = Mapping[int, "int | None"]  # by FAR: bits to ignore (32·word + bit), None: the frame cannot be judged
_CONTENTS = 1  # block type of the contents of block RAM


@dataclass(frozen=True, slots=True)
class Mask:
    """What is not compared, and `why`, in words, for people; `source`: msk, xray or none."""

    of: Callable[[Mapping[int, int]], Masks]  # of frames as they were loaded, by FAR
    source: str
    why: str = ""


def mask_for(bitstream: Path, device: Device) -> Mask:
    """The mask of a bitstream: of the file beside it, of the database, or what is known of every design.

    Raises the refusals of `cm.formats.bitstream` for a ``.msk`` that is damaged, or of another device.
    """
    beside = bitstream.with_name(bitstream.name.split(".")[0] + ".msk")
    if beside.is_file():
        return _of_file(beside, device)
    known = _of_database(device)
    if known is not None:
        return known
    why = (
        "the contents of block RAM are not compared, and nothing says which look-up tables are memories "
        f"(no {beside.name}, no database of Project X-Ray)"
    )
    return Mask(lambda frames: _without_contents(frames, device), "none", why)


def _without_contents(frames: Iterable[int], device: Device) -> Masks:
    return {far: None for far in frames if decode_far(far, device.family).block_type == _CONTENTS}


def _of_file(path: Path, device: Device) -> Mask:
    report = inspect(path)
    if report.idcode is None or (report.idcode ^ device.idcode) & REVISION_MASK:
        raise WrongDevice(
            f"{path}: a mask for {report.device or 'another device'}, beside a bitstream for {device.name}"
        )
    order = frame_order(device.name, device.family)
    found = frames_of(open_image(path), order) if order is not None else {}

    return Mask(lambda frames: {far: found.get(far) for far in frames}, "msk", f"{path.name} says what is not compared")


def _of_database(device: Device) -> Mask | None:
    """None where the database is not installed, or does not know the device."""
    from cm.formats.xray.database import Database  # here: few boards have it
    from cm.formats.xray.volatile import volatile_bits

    if device.family is not Family.SERIES7:
        return None
    try:
        database = Database.open(device.name)
    except CmError:
        return None

    return Mask(partial(volatile_bits, database), "xray", "Project X-Ray's database says what is not compared")

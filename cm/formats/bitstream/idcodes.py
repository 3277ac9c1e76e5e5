# SPDX-License-Identifier: Apache-2.0
"""Devices: the IDCODE a bitstream carries, and the frames of the device's family.

The top nibble of an IDCODE is the silicon revision and never compared. On Zynq UltraScale+ the
IDCODE in a bitstream is that of the PL's own TAP, not the one that JTAG shows (the PS's). Sources:
7-series: UG470 table 1-1, UG585 (device codes), openFPGALoader's part list. Zynq UltraScale+: the
IDCODEs that Vivado's simulation model SIM_CONFIGE3 knows (XilinxUnisimLibrary, Apache-2.0), as far as
they are the PL's; ZU1, ZU3T and K24 from a public table of PL TAPs; ZU3, ZU7, ZU9, K26 also from real
bitstreams. The PL's IDCODEs of ZU11, ZU15, ZU17, ZU19 and of the RFSoCs stand in no public source that
was found: state them (`idcode:`, `--idcode`).
"""

from __future__ import annotations

import re
from enum import Enum
from typing import NamedTuple

from cm.formats.bitstream.errors import UnknownDevice
from cm.frozen import dataclass

REVISION_MASK = 0x0FFFFFFF


class FarLayout(NamedTuple):
    """Bit positions of a frame address: (shift, width) of each field, and the bits that are used."""

    block_type: tuple[int, int]
    row: tuple[int, int]
    column: tuple[int, int]
    minor: tuple[int, int]

    @property
    def used(self) -> int:
        """Mask of the bits that mean something; the others are 0 in a valid address."""
        return sum(((1 << width) - 1) << shift for shift, width in self)


class Family(Enum):
    """A device family: words in a frame, layout of FAR, and frames in its widest column by block type."""

    SERIES7 = ("7series", 101, FarLayout((23, 3), (17, 6), (7, 10), (0, 7)), (42, 128))
    ULTRASCALE_PLUS = ("ultrascale+", 93, FarLayout((24, 3), (18, 6), (8, 10), (0, 8)), (76, 256))

    def __init__(self, label: str, frame_words: int, far: FarLayout, widest: tuple[int, ...]) -> None:
        self.label = label
        self.frame_words = frame_words
        self.far = far
        self.widest = widest


@dataclass(frozen=True, slots=True)
class Device:
    """A device by its name without package and speed grade, e.g. ``xc7z020``."""

    name: str
    idcode: int
    family: Family


_SERIES7 = {
    "xc7z007s": 0x03723093,
    "xc7z010": 0x03722093,
    "xc7z012s": 0x0373C093,
    "xc7z014s": 0x03728093,
    "xc7z015": 0x0373B093,
    "xc7z020": 0x03727093,
    "xc7z030": 0x0372C093,
    "xc7z035": 0x03732093,
    "xc7z045": 0x03731093,
    "xc7z100": 0x03736093,
    "xc7s6": 0x03622093,
    "xc7s15": 0x03620093,
    "xc7s25": 0x037C4093,
    "xc7s50": 0x0362F093,
    "xc7s75": 0x037C8093,
    "xc7s100": 0x037C7093,
    "xc7a12t": 0x037C3093,
    "xc7a15t": 0x0362E093,
    "xc7a25t": 0x037C2093,
    "xc7a35t": 0x0362D093,
    "xc7a50t": 0x0362C093,
    "xc7a75t": 0x03632093,
    "xc7a100t": 0x03631093,
    "xc7a200t": 0x03636093,
    "xc7k70t": 0x03647093,
    "xc7k160t": 0x0364C093,
    "xc7k325t": 0x03651093,
    "xc7k355t": 0x03747093,
    "xc7k410t": 0x03656093,
    "xc7k420t": 0x03752093,
    "xc7k480t": 0x03751093,
}
_ULTRASCALE_PLUS = {
    "xczu1eg": 0x04826093,
    "xczu2eg": 0x04A43093,
    "xczu3eg": 0x04A42093,
    "xczu3teg": 0x04AF2093,
    "xczu4ev": 0x04A47093,
    "xczu5ev": 0x04A46093,
    "xczu6eg": 0x0484B093,
    "xczu7ev": 0x04A5A093,
    "xczu9eg": 0x0484A093,
    "xck24": 0x04A44093,
    "xck26": 0x04A49093,
    "xcau7p": 0x04AF6093,
    "xcau10p": 0x04AC4093,
    "xcau15p": 0x04AC2093,
    "xcau20p": 0x04A65093,
    "xcau25p": 0x04A64093,
    "xcku3p": 0x04A63093,
    "xcku5p": 0x04A62093,
}
DEVICES = tuple(
    Device(name, idcode, family)
    for family, table in ((Family.SERIES7, _SERIES7), (Family.ULTRASCALE_PLUS, _ULTRASCALE_PLUS))
    for name, idcode in table.items()
)

# Dies that are sold under several names: the configuration is the same, and so is the IDCODE.
_ALIASES = {
    "xczu1cg": "xczu1eg",
    "xczu2cg": "xczu2eg",
    "xczu3cg": "xczu3eg",
    "xczu3tcg": "xczu3teg",
    "xczu4cg": "xczu4ev",
    "xczu4eg": "xczu4ev",
    "xczu5cg": "xczu5ev",
    "xczu5eg": "xczu5ev",
    "xczu6cg": "xczu6eg",
    "xczu7cg": "xczu7ev",
    "xczu7eg": "xczu7ev",
    "xczu9cg": "xczu9eg",
    "k24": "xck24",
    "k26": "xck26",
}
_PART = re.compile(r"x[acq]{1,2}(?:k\d+|7[asvzk][a-z]*\d+[st]?|zu\d+[a-z]{2,3}|[kva]u\d+p)|k2[46]")
_PACKAGE = re.compile(r"[il]?-?((?:c[lps]|f[bfghlst]|hc|r[bfs]|s[bf]|ub)[a-z]{0,2}\d{3,4})")


def base_name(part: str) -> str:
    """Return a part's device without package, speed and temperature: ``7z020clg400`` → ``xc7z020``."""
    text = part.strip().lower()
    text = re.sub(r"^(?:x[aq])?(?=7[asvzk])", "xc", text)  # automotive and defence grades: the same die
    found = _PART.match(text)
    name = found.group(0) if found else text.split("-")[0]
    name = re.sub(r"^x[aq](?=zu)", "xc", name)
    return _ALIASES.get(name, name)


def package_of(part: str) -> str | None:
    """Return the package in a part's name: ``xczu7ev-ffvc1156-2-e`` → ``ffvc1156``; None if it names none.

    Of 7-series the letter for what the balls are made of is left out (``7z020clg400`` → ``cl400``):
    the same package is sold with lead and without.
    """
    text = re.sub(r"^(?:x[aq])?(?=7[asvzk])", "xc", part.strip().lower())
    found = _PART.match(text)
    package = _PACKAGE.match(text[found.end() :]) if found else None
    if found is None or package is None:
        return None
    name = package.group(1)
    return re.sub(r"(?<=^..)[gv]", "", name) if found.group(0).startswith("xc7") else name


def device_by_idcode(idcode: int) -> Device | None:
    """Return the device of a bitstream's IDCODE, whatever its revision; None if it is not known."""
    return next((item for item in DEVICES if item.idcode == idcode & REVISION_MASK), None)


def device_by_name(part: str) -> Device | None:
    """Return the device of a part or device name; None if it is not known."""
    name = base_name(part)
    return next((item for item in DEVICES if item.name == name), None)


def known_device(device: str | Device) -> Device:
    """The device itself, or that of a name. Raises UnknownDevice."""
    found = device if isinstance(device, Device) else device_by_name(device)
    if found is None:
        raise UnknownDevice(f"device {device!r} has no IDCODE in cm.formats.bitstream.idcodes; give a Device instead")
    return found


def family_of(idcode: int | None, part: str | None) -> Family | None:
    """Return the family, for a device not in the table by its part's name or its IDCODE's range."""
    known = device_by_idcode(idcode) if idcode is not None else None
    if known is not None:
        return known.family
    name = base_name(part) if part else ""
    if name.startswith("xc7") or (not name and idcode is not None and idcode >> 20 & 0xFF in (0x36, 0x37)):
        return Family.SERIES7
    if re.match(r"x[acq](zu|k\d|[kva]u\d+p)", name) or (
        not name and idcode is not None and idcode >> 20 & 0xFF == 0x4A
    ):
        return Family.ULTRASCALE_PLUS
    return None

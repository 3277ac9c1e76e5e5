# SPDX-License-Identifier: Apache-2.0
"""What an inspection found, as frozen data."""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

from cm.formats.bitstream.container import BitHeader, Container
from cm.formats.bitstream.errors import BitstreamError
from cm.formats.bitstream.idcodes import Family
from cm.frozen import dataclass


class CrcResult(Enum):
    """`ok`: every CRC in the stream is right; `wrong`: one is not; `absent`: the stream has none."""

    OK = "ok"
    WRONG = "wrong"
    ABSENT = "absent"


@dataclass(frozen=True, slots=True)
class Refusal:
    """One reason not to load a bitstream: a code of `cm.formats.bitstream.errors`, and the sentence."""

    code: str
    message: str

    @classmethod
    def of(cls, error: type[BitstreamError], message: str) -> Refusal:
        """With the code of an error."""
        return cls(error.code, message)


class Footprint(NamedTuple):
    """Frames written from one column's address on; a run may go on into the columns behind it.

    `frames` counts what a run pushes through the frame buffer, padding frames too; frames that are
    written twice (partial bitstreams of 7-series do that) count once. `last` is the column that the
    last real frame falls into (the number of columns where it goes past the row's end); None for a
    device whose columns are not known. A tuple, because a compressed bitstream has a thousand of them.
    """

    block_type: int
    row: int
    column: int
    frames: int
    last: int | None = None

    def __str__(self) -> str:
        begin = f"{self.frames} frames from block type {self.block_type} row {self.row} column {self.column}"
        return begin if self.last in (None, self.column) else f"{begin} into column {self.last}"


@dataclass(frozen=True, slots=True)
class Section:
    """One stretch from sync to DESYNC: byte offset of its sync word in the file, and its length."""

    offset: int
    length: int
    frames: int


@dataclass(frozen=True, slots=True)
class Report:
    """What a bitstream is. `problems` are reasons to refuse it whatever it is meant for.

    `partial` is what the header says, or, without a header, what the packets look like;
    `looks_partial` is always the latter (a full bitstream sets WBSTAR and TIMER).
    """

    container: Container
    header: BitHeader | None
    device: str | None
    idcode: int | None
    family: Family | None
    partial: bool
    looks_partial: bool
    sections: tuple[Section, ...]
    frames: int
    crc: CrcResult
    footprint: tuple[Footprint, ...]
    encrypted: bool
    compressed: bool
    length: int
    sha256: str
    problems: tuple[Refusal, ...]

    @property
    def design(self) -> str | None:
        """The design's name in the header."""
        return self.header.design if self.header else None

    @property
    def part(self) -> str | None:
        """The full part name in the header."""
        return self.header.part if self.header else None

    @property
    def user_id(self) -> int | None:
        """The USERID in the header, where one was set."""
        return self.header.user_id if self.header else None

    @property
    def date(self) -> str | None:
        """Date and time in the header, as written there."""
        return f"{self.header.date} {self.header.time}" if self.header else None

    def to_json(self) -> dict[str, Any]:
        """Return plain data for ``--json``; the footprint is a list of its fields."""
        return {
            "device": self.device,
            "idcode": None if self.idcode is None else f"0x{self.idcode:08x}",
            "family": self.family.label if self.family else None,
            "partial": self.partial,
            "sections": len(self.sections),
            "frames": self.frames,
            "crc": self.crc.value,
            "footprint": [
                {
                    "block_type": item.block_type,
                    "row": item.row,
                    "column": item.column,
                    "frames": item.frames,
                    "last_column": item.last,
                }
                for item in self.footprint
            ],
            "container": self.container.value,
            "design": self.design,
            "part": self.part,
            "date": self.date,
            "user_id": None if self.user_id is None else f"0x{self.user_id:08x}",
            "encrypted": self.encrypted,
            "compressed": self.compressed,
            "length": self.length,
            "sha256": self.sha256,
            "problems": [{"code": item.code, "message": item.message} for item in self.problems],
        }

# SPDX-License-Identifier: Apache-2.0
"""Containers: `.bit`, `.bin` in either byte order, bootgen boot images; Versal's images are recognised and refused.

Conversion between them is byte for byte; `to_dma_words` gives the words that DMA memory needs.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import BinaryIO, TypeAlias

from cm.device.native.bitstream import swap
from cm.formats.bitstream.bootimage import SEARCH, find_bitstream, find_sync, is_boot_image, whole_words
from cm.formats.bitstream.errors import BadContainer, BitstreamError, NoSync, Truncated, UnknownDevice
from cm.frozen import dataclass

_SIGNATURE = 0x10, bytes.fromhex("665599aa") + b"XNLX"  # where the boot header has it
_TABLE_AT = 0xC4  # of the boot header: the byte where the image header table begins
_TABLE = 0x80  # bytes of that table
_KINDS = 0x28, {0x46504449, 0x50504449}  # FPDI, PPDI: what the table says that it is of
_ID_CODE, _PDI_ID, _PARENT_ID, _EXTENDED = 0x18, 0x20, 0x24, 0x44


def _word(data: memoryview, at: int) -> int:
    return int.from_bytes(data[at : at + 4], "little")


def _is_table(table: memoryview) -> bool:
    at, kinds = _KINDS
    return len(table) >= _TABLE and _word(table, at) in kinds


def _find_table(data: memoryview) -> memoryview | None:
    at, signature = _SIGNATURE
    if bytes(data[at : at + len(signature)]) == signature:
        begin = _word(data, _TABLE_AT)
        return data[begin : begin + _TABLE]
    return data[:_TABLE] if _is_table(data[:_TABLE]) else None  # a partial one has no boot header


def check_pdi(data: memoryview) -> None:
    """Raise UnknownDevice, with device and identifiers, if the file is a Versal .pdi."""
    table = _find_table(data)
    if table is None:
        return
    if not _is_table(table):
        raise UnknownDevice("a Versal .pdi whose image header table is damaged or missing; Versal is not supported")
    ids = f"UID {_word(table, _PDI_ID):08X}, parent UID {_word(table, _PARENT_ID):08X}"
    device = f"IDCODE {_word(table, _ID_CODE):08X}, extended {_word(table, _EXTENDED):08X}"
    raise UnknownDevice(f"a Versal .pdi ({device}; {ids}): Versal is not supported, only 7-series and UltraScale+")


Source: TypeAlias = "bytes | bytearray | memoryview | Path | str"

NO_USER_ID = 0xFFFFFFFF
_HEX = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{1,8}")
_HEAD = SEARCH + 4096  # bytes: enough to tell what a file is
_BIT_MAGIC = bytes.fromhex("00090ff00ff00ff00ff0000001")


class Container(Enum):
    """How the configuration words are packed in the file."""

    BIT = "bit"
    BIN_SWAPPED = "bin"
    BIN_STRAIGHT = "bin-straight"
    BOOTGEN = "bootgen"


@dataclass(frozen=True, slots=True)
class BitHeader:
    """The header fields of a `.bit`: `fields` are the ``KEY=value`` pairs behind the design's name.

    The value is None where only a word stands. Bytes that are not UTF-8 survive as surrogates.
    """

    design: str
    fields: tuple[tuple[str, str | None], ...]
    part: str
    date: str
    time: str

    def field(self, key: str) -> str | None:
        """Return a pair's value, e.g. of ``PARTIAL``; None if the header has no such pair."""
        return next((value for name, value in self.fields if name.upper() == key.upper()), None)

    @property
    def user_id(self) -> int | None:
        """The 32-bit ``UserID`` of the design (Vivado: BITSTREAM.CONFIG.USERID); None if it says none.

        FFFFFFFF is what Vivado writes where none was set.
        """
        text = self.field("UserID") or ""
        number = int(text, 16) if _HEX.fullmatch(text) else NO_USER_ID
        return None if number == NO_USER_ID else number

    @property
    def partial(self) -> bool:
        """Whether the header says ``PARTIAL=TRUE``."""
        return (self.field("PARTIAL") or "").upper() == "TRUE"


@dataclass(frozen=True, slots=True)
class Image:
    """An opened bitstream: `stream` is a view of its configuration words, `offset` where they begin.

    `swapped`: each word's bytes are reversed in `stream`, as a DMA-fed ICAP reads them from memory.
    `stream` is a whole number of words; what a damaged file has beyond is in `rest` (0 to 3 bytes).
    `encrypted`: the boot image says so (a `.bit` says so in its packets, see `cm.formats.bitstream.inspect`).
    """

    container: Container
    header: BitHeader | None
    stream: memoryview
    offset: int
    swapped: bool
    rest: int = 0
    encrypted: bool = False


def read_source(source: Source) -> memoryview:
    """Return the bytes of a file or of a buffer; a `str` is a path.

    A file whose first bytes are not bitstream's is not read to its end. Raises what `open_image` raises.
    """
    if isinstance(source, (str, Path)):
        with Path(source).open("rb") as file:
            return memoryview(read_bitstream(file))
    return memoryview(source).cast("B")


def read_bitstream(file: BinaryIO) -> bytes:
    """Return the bytes of an open file, all of them; refuses from the head what is not a bitstream."""
    head = file.read(_HEAD)
    check_head(memoryview(head))
    return head + file.read()


def check_head(head: memoryview) -> None:
    """Refuse what cannot become a bitstream, whatever follows. Raises NoSync or UnknownDevice."""
    check_pdi(head)
    if bytes(head[: len(_BIT_MAGIC)]) != _BIT_MAGIC and not is_boot_image(head):
        _find_in_bin(head)


def _text(data: memoryview) -> str:
    return bytes(data).decode(errors="surrogateescape")


def _text_field(data: memoryview, at: int, key: str) -> tuple[str, int]:
    """Read one of the fields a to d; return its text and where the next one begins."""
    if len(data) < at + 3:
        raise Truncated(f".bit header ends at byte {len(data)}, where field {key!r} should be")
    if data[at] != ord(key):
        raise BadContainer(f".bit header: field {key!r} expected at byte {at}, found 0x{data[at]:02x}")
    (length,) = struct.unpack_from(">H", data, at + 1)
    end = at + 3 + length
    if end > len(data):
        raise Truncated(f".bit header: field {key!r} says {length} bytes, the file ends {end - len(data)} bytes before")
    if length == 0 or data[end - 1] != 0:
        raise BadContainer(f".bit header: field {key!r} at byte {at} does not end with NUL")
    return _text(data[at + 3 : end - 1]), end


def _parse_header(data: memoryview) -> tuple[BitHeader, int]:
    """Read the fields a to e; return them and where the configuration words begin."""
    at = len(_BIT_MAGIC)
    texts = []
    for key in "abcd":
        text, at = _text_field(data, at, key)
        texts.append(text)
    if len(data) < at + 5:
        raise Truncated(f".bit header ends at byte {len(data)}, where field 'e' should be")
    if data[at] != ord("e"):
        raise BadContainer(f".bit header: field 'e' expected at byte {at}, found 0x{data[at]:02x}")
    (length,) = struct.unpack_from(">I", data, at + 1)
    there = len(data) - at - 5
    if length > there:
        raise Truncated(f".bit header says {length} bytes of configuration, {there} are there")
    if length < there:
        raise BadContainer(f".bit header says {length} bytes of configuration, {there - length} more follow")
    name, *pairs = texts[0].split(";")
    fields = tuple((key, value if mark else None) for key, mark, value in (pair.partition("=") for pair in pairs))
    return BitHeader(name, fields, *texts[1:]), at + 5


def pack_bit(header: BitHeader, stream: bytes) -> bytes:
    """Return the `.bit` file of big-endian configuration words."""
    pairs = (key if value is None else f"{key}={value}" for key, value in header.fields)
    name = ";".join([header.design, *pairs])
    parts = [_BIT_MAGIC]
    for key, text in {b"a": name, b"b": header.part, b"c": header.date, b"d": header.time}.items():
        raw = text.encode(errors="surrogateescape") + b"\0"
        parts.append(key + struct.pack(">H", len(raw)) + raw)
    parts.append(b"e" + struct.pack(">I", len(stream)) + stream)
    return b"".join(parts)


def _open_bit(data: memoryview) -> Image:
    header, offset = _parse_header(data)
    stream, rest = whole_words(data[offset:])
    sync = find_sync(stream, 0, SEARCH)
    if sync is None:
        raise NoSync(f"no sync word AA995566 in the first {min(len(stream), SEARCH)} bytes after the .bit header")
    if sync[1]:
        raise BadContainer("the words behind the .bit header are byte-swapped: convert a .bit from the original file")
    return Image(Container.BIT, header, stream, offset, False, rest)


# What lies in a bitstream's place, and what to do. A sync word whose bytes are reversed bit by bit: for an SPI flash.
_OTHERS = (
    (re.compile(rb"\Z"), "the file is empty"),
    (re.compile(rb"\x1f\x8b"), "compressed by gzip: unpack it first"),
    (re.compile(rb"PK\x03\x04"), "a zip archive: of an .xsa, cm build collect takes what is in it"),
    (re.compile(rb"version https://git-lfs"), "a pointer of Git LFS instead of the file: git lfs pull fetches it"),
    (re.compile(rb"(?s).*(?:\x55\x99\xaa\x66|\x66\xaa\x99\x55)"),
     "the bits of each byte are reversed: write_cfgmem leaves them as they are with -disablebitswap"),
)  # fmt: skip


def _find_in_bin(data: memoryview) -> bool:
    """Return whether the words of a .bin are swapped."""
    sync = find_sync(data, 0, SEARCH)
    if sync is None:
        searched = bytes(data[:SEARCH])
        plain = f"neither a .bit header nor a boot image, and no sync word in the first {len(searched)} bytes"
        raise NoSync(next((what for mark, what in _OTHERS if mark.match(searched)), plain))
    return sync[1]


def _open_bin(data: memoryview) -> Image:
    stream, rest = whole_words(data)
    swapped = _find_in_bin(data)
    return Image(Container.BIN_SWAPPED if swapped else Container.BIN_STRAIGHT, None, stream, 0, swapped, rest)


def _open_boot_image(data: memoryview) -> Image:
    found = find_bitstream(data)
    stream, rest = whole_words(data[found.begin : found.end])
    return Image(Container.BOOTGEN, None, stream, found.begin, found.swapped, rest, found.encrypted)


@contextmanager
def named(source: Source) -> Iterator[None]:
    """Put the file's name in front of a refusal, if `source` is a path."""
    try:
        yield
    except BitstreamError as error:
        if isinstance(source, (str, Path)):
            raise type(error)(f"{source}: {error}") from error
        raise


def open_image(source: Source) -> Image:
    """Recognise the container and find the configuration words, without looking into them.

    Raises `BadContainer`, `Truncated` or `NoSync`; OSError where a path cannot be read.
    """
    with named(source):
        return _open(read_source(source))


def _open(data: memoryview) -> Image:
    check_pdi(data)
    if bytes(data[: len(_BIT_MAGIC)]) == _BIT_MAGIC:
        return _open_bit(data)
    if is_boot_image(data):
        return _open_boot_image(data)
    return _open_bin(data)


def _ordered(image: Image, swapped: bool) -> bytes:
    """Return the configuration words in this byte order; a rest of a word is an error."""
    if image.rest:
        raise BadContainer(f"{image.rest} bytes follow the last whole word: the file is damaged")
    return bytes(image.stream) if image.swapped == swapped else swap(image.stream)


def to_dma_words(source: Source | Image) -> bytes:
    """Return the configuration words in memory order (``66 55 99 AA``), as ICAP DMA and PCAP read them.

    The container is taken off; the words are those of the file, padding included.
    """
    image = source if isinstance(source, Image) else open_image(source)
    return _ordered(image, swapped=True)


def _recognisable(data: bytes, form: Container) -> bytes:
    """Refuse words that only a header could distinguish from another container: a `.bin` has none."""
    try:
        found = open_image(data).container
    except BitstreamError as error:
        raise BadContainer(f"the words begin as no {form.value} may: it would be refused ({error})") from error
    if found is not form:
        raise BadContainer(f"the words begin like those of a {found.value}: as a {form.value} they would be read so")
    return data


def convert(source: Source, form: Container, header: BitHeader | None = None) -> bytes:
    """Return the bitstream in another container.

    A `.bit` needs `header` where the source has none; words that could not be recognised as a `.bin` again are
    refused. Converting between `.bit`, swapped and straight `.bin` and back gives the same bytes. Boot images are
    read, not written.
    """
    image = open_image(source)
    if form is Container.BOOTGEN:
        raise BadContainer("boot images are read, not written: use bootgen with the .bit")
    if form is not Container.BIT:
        return _recognisable(_ordered(image, swapped=form is Container.BIN_SWAPPED), form)
    found = header or image.header
    if found is None:
        raise BadContainer("a .bit needs a header (design, part, date, time), and a .bin has none: give one")
    return pack_bit(found, _ordered(image, swapped=False))

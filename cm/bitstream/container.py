# SPDX-License-Identifier: Apache-2.0
"""Containers: `.bit`, `.bin` in either byte order, and bootgen boot images.

No length in a file is trusted: each is compared with the bytes that are there before it is used.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TypeAlias

from cm.bitstream.errors import BadContainer, BitstreamError, NoSync, Truncated

Source: TypeAlias = "bytes | bytearray | memoryview | Path | str"

_BIT_MAGIC = bytes.fromhex("00090ff00ff00ff00ff0000001")
_SYNC_BIG = bytes.fromhex("aa995566")
_SYNC_LITTLE = bytes.fromhex("665599aa")
_PADDING = {bytes([255] * 4), bytes.fromhex("000000bb"), bytes.fromhex("11220044")}
_SEARCH = 1 << 16  # bytes: in a plain .bin the sync word stands within the first few hundred
_BOOT_MAGIC = 0x24
_BOOT_SIGNATURE = b"XNLX"
_BOOT_HEADER = 0x8C0  # bytes; the image headers and the partitions follow
_BOOT_TABLE = 0x9C  # where the header says at which byte the partition headers are
_BOOT_PARTITIONS = 32
_BOOT_FOR_PL = 2  # a partition's destination in its attributes


class Container(Enum):
    """How the configuration words are packed in the file."""

    BIT = "bit"
    BIN_SWAPPED = "bin"
    BIN_STRAIGHT = "bin-straight"
    BOOTGEN = "bootgen"


@dataclass(frozen=True, slots=True)
class BitHeader:
    """The header fields of a `.bit`: `fields` are the ``KEY=value`` pairs behind the design's name.

    The value is None where only a word stands. Bytes that are no UTF-8 survive as surrogates.
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
    def partial(self) -> bool:
        """Whether the header says ``PARTIAL=TRUE``."""
        return (self.field("PARTIAL") or "").upper() == "TRUE"


@dataclass(frozen=True, slots=True)
class Image:
    """An opened bitstream: `stream` is a view of its configuration words, `offset` where they begin.

    `swapped`: each word's bytes are reversed in `stream`, as a DMA-fed ICAP reads them from memory.
    `stream` is a whole number of words; what a damaged file has beyond is in `rest` (0 to 3 bytes).
    `encrypted`: the boot image says so (a `.bit` says so in its packets, see `cm.bitstream.inspect`).
    """

    container: Container
    header: BitHeader | None
    stream: memoryview
    offset: int
    swapped: bool
    rest: int = 0
    encrypted: bool = False


def read_source(source: Source) -> memoryview:
    """Return the bytes of a file or of a buffer; a `str` is a path."""
    if isinstance(source, (str, Path)):
        return memoryview(Path(source).read_bytes())
    return memoryview(source).cast("B")


def _text(data: memoryview) -> str:
    return bytes(data).decode("utf-8", "surrogateescape")


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
    for key, text in zip("abcd", (name, header.part, header.date, header.time), strict=True):
        raw = text.encode("utf-8", "surrogateescape") + b"\0"
        parts.append(key.encode() + struct.pack(">H", len(raw)) + raw)
    parts.append(b"e" + struct.pack(">I", len(stream)) + stream)
    return b"".join(parts)


def _find_sync(data: memoryview, start: int, end: int) -> tuple[int, bool]:
    """Return where the first word-aligned sync word is, and whether it is swapped; -1 if there is none."""
    found = []
    window = bytes(data[start:end])
    for pattern, swapped in ((_SYNC_BIG, False), (_SYNC_LITTLE, True)):
        at = window.find(pattern)
        while at >= 0 and at % 4:
            at = window.find(pattern, at + 1)
        if at >= 0:
            found.append((start + at, swapped))
    return min(found, default=(-1, False))


def _whole(data: memoryview) -> tuple[memoryview, int]:
    rest = len(data) % 4
    return (data[: len(data) - rest], rest) if rest else (data, 0)


def _open_bit(data: memoryview) -> Image:
    header, offset = _parse_header(data)
    stream, rest = _whole(data[offset:])
    at, swapped = _find_sync(stream, 0, min(len(stream), _SEARCH))
    if at < 0:
        raise NoSync(f"no sync word AA995566 in the first {min(len(stream), _SEARCH)} bytes after the .bit header")
    if swapped:
        raise BadContainer("the words behind the .bit header are byte-swapped: convert a .bit from the original file")
    return Image(Container.BIT, header, stream, offset, False, rest)


def _open_bin(data: memoryview) -> Image:
    stream, rest = _whole(data)
    at, swapped = _find_sync(stream, 0, min(len(stream), _SEARCH))
    if at < 0:
        raise NoSync(
            f"neither a .bit header nor a boot image, and no sync word in the first {min(len(data), _SEARCH)} bytes"
        )
    return Image(Container.BIN_SWAPPED if swapped else Container.BIN_STRAIGHT, None, stream, 0, swapped, rest)


def _is_boot_image(data: memoryview) -> bool:
    return len(data) >= _BOOT_HEADER and bytes(data[_BOOT_MAGIC : _BOOT_MAGIC + 4]) == _BOOT_SIGNATURE


def _partitions(data: memoryview) -> Iterator[tuple[int, int, bool]]:
    """Give begin, end and encryption of a boot image's partitions for the PL, as far as its table is sound.

    A header is sixteen words (UG821 for Zynq, UG1283 for Zynq UltraScale+), the last one a check sum.
    """
    (table,) = struct.unpack_from("<I", data, _BOOT_TABLE)
    for at in range(table, min(table + 64 * _BOOT_PARTITIONS, len(data) - 63), 64):
        words = struct.unpack_from("<16I", data, at)
        if ~sum(words[:15]) & 0xFFFFFFFF != words[15] or words[2] == 0:
            return
        for offset, attributes in ((words[5], words[6]), (words[8], words[9])):
            begin, end = 4 * offset, 4 * (offset + words[1])
            if attributes >> 4 & 7 == _BOOT_FOR_PL and _BOOT_HEADER <= begin < end <= len(data):
                yield begin, end, words[0] != words[1]


def _begin_of_stream(data: memoryview, sync: int, swapped: bool) -> int:
    """Go back from the sync word over the padding in front of it."""
    at = sync
    while at - 4 >= _BOOT_HEADER:
        word = bytes(data[at - 4 : at])
        if (word[::-1] if swapped else word) not in _PADDING:
            break
        at -= 4
    return at


def _boot_stream(data: memoryview) -> tuple[int, int, bool, bool]:
    """Return where the bitstream begins and ends, whether it is swapped, and whether it is encrypted."""
    for begin, end, encrypted in _partitions(data):
        sync, swapped = _find_sync(data, begin, min(begin + _SEARCH, end))
        if sync >= 0:
            return begin, end, swapped, encrypted
    # No table, or a damaged one: the first sync word behind the header, and all that follows.
    sync, swapped = _find_sync(data, _BOOT_HEADER, len(data))
    if sync < 0:
        raise NoSync("a boot image without a bitstream partition: no sync word after its header")
    return _begin_of_stream(data, sync, swapped), len(data), swapped, False


def _open_boot_image(data: memoryview) -> Image:
    (encryption,) = struct.unpack_from("<I", data, 0x28)
    begin, end, swapped, encrypted = _boot_stream(data)
    length = len(bytes(data[begin:end]).rstrip(b"\0"))
    stream, rest = _whole(data[begin : min(end, begin + -(-length // 4) * 4)])
    return Image(Container.BOOTGEN, None, stream, begin, swapped, rest, encrypted or encryption != 0)


@contextmanager
def named(source: Source) -> Iterator[None]:
    """Put the file's name in front of what is refused, where `source` is a path."""
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
    if bytes(data[: len(_BIT_MAGIC)]) == _BIT_MAGIC:
        return _open_bit(data)
    if _is_boot_image(data):
        return _open_boot_image(data)
    return _open_bin(data)

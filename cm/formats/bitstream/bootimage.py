# SPDX-License-Identifier: Apache-2.0
"""Boot images as bootgen writes them: which of their bytes are the bitstream, and where its words begin."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator

from cm.formats.bitstream.errors import NoSync
from cm.frozen import dataclass

_SYNC_BIG = bytes.fromhex("aa995566")
_SYNC_LITTLE = bytes.fromhex("665599aa")
SEARCH = 1 << 16  # bytes: in a plain .bin the sync word stands within the first few hundred


def find_sync(data: memoryview, start: int, end: int) -> tuple[int, bool] | None:
    """Return where the first word-aligned sync word is, and whether it is swapped."""
    found = []
    window = bytes(data[start:end])
    for pattern, swapped in ((_SYNC_BIG, False), (_SYNC_LITTLE, True)):
        at = window.find(pattern)
        while at >= 0 and at % 4:
            at = window.find(pattern, at + 1)
        if at >= 0:
            found.append((start + at, swapped))
    return min(found, default=None)


def whole_words(data: memoryview) -> tuple[memoryview, int]:
    """Return the words of `data`, and how many bytes of one more there are."""
    rest = len(data) % 4
    return data[: len(data) - rest], rest


_PADDING = {bytes([255] * 4), bytes.fromhex("000000bb"), bytes.fromhex("11220044")}
_BOOT_MAGIC = 0x24
_BOOT_SIGNATURE = b"XNLX"
_BOOT_HEADER = 0x8C0  # bytes; the image headers and the partitions follow
_BOOT_TABLE = 0x9C  # where the header says at which byte the partition headers are
_BOOT_PARTITIONS = 32
_BOOT_FOR_PL = 2  # a partition's destination in its attributes
_BOOT_ENCRYPTED = 1 << 7  # of the attributes, on Zynq UltraScale+
_BOOT_KEY_SOURCE = 0x28  # of the boot header: 0 where nothing is encrypted


@dataclass(frozen=True, slots=True)
class BootStream:
    """Bytes `begin` to `end` of the file; whether their words are swapped, and whether they are encrypted."""

    begin: int
    end: int
    swapped: bool
    encrypted: bool


def is_boot_image(data: memoryview) -> bool:
    """Whether the file begins with a boot header."""
    return len(data) >= _BOOT_HEADER and bytes(data[_BOOT_MAGIC : _BOOT_MAGIC + 4]) == _BOOT_SIGNATURE


def _headers(data: memoryview) -> Iterator[tuple[int, ...]]:
    """Give the partition headers of a boot image, as far as its table is sound.

    A header is sixteen words (UG821 for Zynq, UG1283 for Zynq UltraScale+), the last one a check sum.
    """
    (table,) = struct.unpack_from("<I", data, _BOOT_TABLE)
    for at in range(table, min(table + 64 * _BOOT_PARTITIONS, len(data) - 63), 64):
        words = struct.unpack_from("<16I", data, at)
        if ~sum(words[:15]) & 0xFFFFFFFF != words[15] or words[2] == 0:
            return
        yield words


def _names_key(data: memoryview) -> bool:
    return any(data[_BOOT_KEY_SOURCE : _BOOT_KEY_SOURCE + 4])


def _partitions(data: memoryview, headers: Iterable[tuple[int, ...]]) -> Iterator[tuple[int, int, bool]]:
    """Give begin, end and encryption of the partitions for the PL.

    On Zynq the two lengths of a partition differ where it is encrypted, but by its padding too: then
    the boot header names the key's source (UG821). On Zynq UltraScale+ an attribute says it (UG1283).
    """
    key = _names_key(data)
    for words in headers:
        zynq = words[5], words[6], key and words[0] != words[1]
        zynqmp = words[8], words[9], words[9] & _BOOT_ENCRYPTED != 0
        for offset, attributes, encrypted in (zynq, zynqmp):
            begin, end = 4 * offset, 4 * (offset + words[1])
            if attributes >> 4 & 7 == _BOOT_FOR_PL and _BOOT_HEADER <= begin < end <= len(data):
                yield begin, end, encrypted


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
    headers = list(_headers(data))
    for begin, end, encrypted in _partitions(data, headers):
        sync = find_sync(data, begin, min(begin + SEARCH, end))
        if sync or encrypted:
            return begin, end, sync is None or sync[1], encrypted
    if headers:
        raise NoSync(f"a boot image of {len(headers)} partitions, none of which is a bitstream for the PL")
    # No table, or a damaged one: the first sync word behind the header, and all that follows.
    sync = find_sync(data, _BOOT_HEADER, len(data))
    if sync is None:
        raise NoSync("a boot image without a bitstream partition: no sync word after its header")
    return _begin_of_stream(data, *sync), len(data), sync[1], _names_key(data)


def find_bitstream(data: memoryview) -> BootStream:
    """Find the bitstream of a boot image, without the zeros at its end. Raises `NoSync`."""
    begin, end, swapped, encrypted = _boot_stream(data)
    if not encrypted:
        length = len(bytes(data[begin:end]).rstrip(b"\0"))
        end = begin + length + -length % 4
    return BootStream(begin, end, swapped, encrypted)

# SPDX-License-Identifier: Apache-2.0
"""Boot images as bootgen writes them: which of their bytes are the bitstream."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from cm.bitstream.errors import NoSync
from cm.bitstream.sync import SEARCH, find_sync

_PADDING = {bytes([255] * 4), bytes.fromhex("000000bb"), bytes.fromhex("11220044")}
_BOOT_MAGIC = 0x24
_BOOT_SIGNATURE = b"XNLX"
_BOOT_HEADER = 0x8C0  # bytes; the image headers and the partitions follow
_BOOT_TABLE = 0x9C  # where the header says at which byte the partition headers are
_BOOT_PARTITIONS = 32
_BOOT_FOR_PL = 2  # a partition's destination in its attributes


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
        sync, swapped = find_sync(data, begin, min(begin + SEARCH, end))
        if sync >= 0:
            return begin, end, swapped, encrypted
    # No table, or a damaged one: the first sync word behind the header, and all that follows.
    sync, swapped = find_sync(data, _BOOT_HEADER, len(data))
    if sync < 0:
        raise NoSync("a boot image without a bitstream partition: no sync word after its header")
    return _begin_of_stream(data, sync, swapped), len(data), swapped, False


def find_bitstream(data: memoryview) -> BootStream:
    """Find the bitstream of a boot image, without the zeros at its end. Raises `NoSync`."""
    (encryption,) = struct.unpack_from("<I", data, 0x28)
    begin, end, swapped, encrypted = _boot_stream(data)
    length = len(bytes(data[begin:end]).rstrip(b"\0"))
    return BootStream(begin, min(end, begin + -(-length // 4) * 4), swapped, encrypted or encryption != 0)

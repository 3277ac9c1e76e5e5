# SPDX-License-Identifier: Apache-2.0
"""Versal's programmable device images: recognised and refused.

Their contents are not configuration packets, so nothing that is checked of other devices could be
checked of them. Layout: bootgen (Apache-2.0), bootheader-versal.h and imageheadertable-versal.h.
"""

from __future__ import annotations

import struct

from cm.formats.bitstream.errors import UnknownDevice

_SIGNATURE = 0x10, bytes.fromhex("665599aa") + b"XNLX"  # where the boot header has it
_TABLE_AT = 0xC4  # of the boot header: the byte where the image header table begins
_TABLE = 0x80  # bytes of that table
_KINDS = 0x28, {0x46504449, 0x50504449}  # FPDI, PPDI: what the table says that it is of
_ID_CODE, _PDI_ID, _PARENT_ID, _EXTENDED = 0x18, 0x20, 0x24, 0x44


def _word(table: memoryview, at: int) -> int:
    word: int = struct.unpack_from("<I", table, at)[0]
    return word


def _is_table(table: memoryview) -> bool:
    at, kinds = _KINDS
    return len(table) >= _TABLE and _word(table, at) in kinds


def _find_table(data: memoryview) -> memoryview | None:
    at, signature = _SIGNATURE
    if bytes(data[at : at + len(signature)]) == signature:
        begin = _word(data, _TABLE_AT) if len(data) >= _TABLE_AT + 4 else len(data)
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

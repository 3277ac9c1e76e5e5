# SPDX-License-Identifier: Apache-2.0
"""The CRC of configuration words in the simulated board's port (``csrc/sim_crc.h``)."""

from __future__ import annotations

from typing import Any

from cm.device.native._cm import ffi, lib


def words(crc: int, register: int, data: Any) -> int:
    """The CRC after words written to a register; `data`: a buffer of uint32, which is not copied."""
    return int(lib.cm_sim_crc(crc, register, ffi.from_buffer("uint32_t[]", data), len(data)))


def word(crc: int, register: int, value: int) -> int:
    """The CRC after one word."""
    return int(lib.cm_sim_crc_word(crc, register, value))

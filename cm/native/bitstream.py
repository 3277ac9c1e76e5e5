# SPDX-License-Identifier: Apache-2.0
"""Thin typed functions over ``csrc/bitstream.c``: the configuration port and its CRC.

Data is anything with the buffer protocol and is never copied. Events come as rows of a numpy array
of `event_dtype`; what their fields mean for each kind stands in ``csrc/bitstream.h``.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

from cm.native._cm import ffi, lib

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

Event: TypeAlias = "np.void"
Events: TypeAlias = "npt.NDArray[np.void]"

SYNC: int = lib.CM_CONFIG_SYNC
WRITE: int = lib.CM_CONFIG_WRITE
FRAMES: int = lib.CM_CONFIG_FRAMES
MULTI: int = lib.CM_CONFIG_MULTI
CRC: int = lib.CM_CONFIG_CRC
DESYNC: int = lib.CM_CONFIG_DESYNC
FILL: int = lib.CM_CONFIG_FILL
STRAY: int = lib.CM_CONFIG_STRAY
OPAQUE: int = lib.CM_CONFIG_OPAQUE
FAULT: int = lib.CM_CONFIG_FAULT

_BATCH = 512


@cache
def event_dtype() -> np.dtype[np.void]:
    """A row of events; numpy is imported by those that look at the events, as not all users of bitstreams do."""
    import numpy as np

    fields = [("word", "=u8"), *((name, "=u4") for name in ("kind", "reg", "value", "count", "extra", "frames"))]
    return np.dtype(fields)


def crc(value: int, register: int, words: Any, swapped: bool = False) -> int:
    """Continue CRC ``value`` with whole 32-bit ``words`` (a buffer) written to ``register``."""
    data = ffi.from_buffer("uint8_t[]", words)
    return int(lib.cm_config_crc(value, register, data, len(data) // 4, swapped))


def swap(words: Any) -> bytes:
    """Return ``words`` with the bytes of each 32-bit word reversed; the length is a multiple of 4."""
    data = ffi.from_buffer("uint8_t[]", words)
    result = bytearray(len(data))
    lib.cm_config_swap(ffi.from_buffer("uint8_t[]", result, require_writable=True), data, len(data) // 4)
    return bytes(result)


class PacketProcessor:
    """A configuration port: feed it words, get events. Not thread-safe; holds no other resource."""

    __slots__ = ("_events", "_made", "_port")

    def __init__(self, capture: bool = False) -> None:
        self._port = ffi.new("struct cm_config_port *")
        self._events = ffi.new("struct cm_config_event[]", _BATCH)
        self._made = ffi.new("size_t *")
        lib.cm_config_reset(self._port, capture)

    def reset(self, capture: bool = False) -> None:
        """Go back to the state after power-on."""
        lib.cm_config_reset(self._port, capture)

    def feed(self, words: Any, swapped: bool, start: int = 0) -> tuple[int, Events]:
        """Consume 32-bit words of the buffer from word ``start`` on.

        Returns how many were consumed (fewer than there are when the events were full, or a capture
        stopped it: call again) and the events, in order.
        """
        data = ffi.from_buffer("uint8_t[]", words)
        count = len(data) // 4 - start
        used = lib.cm_config_feed(self._port, data + 4 * start, count, swapped, self._events, _BATCH, self._made)
        import numpy as np

        dtype = event_dtype()
        size = self._made[0] * dtype.itemsize
        return int(used), np.frombuffer(bytes(ffi.buffer(self._events, size)), dtype=dtype)

    @property
    def phase(self) -> int:
        """0 out of sync, 1 inside a packet, 2 in sync between packets, 3 after a fault."""
        return int(lib.cm_config_phase(self._port))

    @property
    def position(self) -> int:
        """Words consumed since the reset."""
        return int(self._port.position)

    @property
    def head(self) -> tuple[int, ...]:
        """The first words (at most one frame) of the newest FDRI run."""
        return tuple(self._port.head[0 : self._port.head_count])

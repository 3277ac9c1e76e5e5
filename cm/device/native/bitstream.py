# SPDX-License-Identifier: Apache-2.0
"""Thin typed functions over ``csrc/bitstream.c``: the configuration port and its CRC.

Data is anything with the buffer protocol and is never copied. There is no numpy here: a manager checks
bitstreams, and would need 11 MiB for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from struct import Struct
from typing import Any, NamedTuple

from cm.device.native._cm import ffi, lib

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
_ROW = Struct("=Q6I")  # struct cm_config_event


class Event(NamedTuple):
    """What a port did; ``csrc/bitstream.h`` says what the fields mean for each kind."""

    word: int
    kind: int
    reg: int
    value: int
    count: int  # type: ignore[assignment]  # tuples have a method of that name
    extra: int
    frames: int


class Events:
    """Many events, in order, in the 32 bytes each that the shim uses: as tuples they would be eight times as long.

    A bitstream that writes each frame by itself has tens of thousands.
    """

    __slots__ = ("_rows", "kinds")

    def __init__(self) -> None:
        self._rows = bytearray()
        self.kinds: set[int] = set()  # of all events in it

    def append(self, event: Event) -> None:
        """Add one at the end."""
        self._rows += _ROW.pack(*event)
        self.kinds.add(event.kind)

    def __iter__(self) -> Iterator[Event]:
        return map(Event._make, _ROW.iter_unpack(self._rows))

    def __len__(self) -> int:
        return len(self._rows) // _ROW.size


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

    def feed(self, words: Any, swapped: bool, start: int = 0) -> tuple[int, list[Event]]:
        """Consume 32-bit words of the buffer from word ``start`` on.

        Returns how many were consumed (fewer than there are when the events were full, or a capture
        stopped it: call again) and the events, in order, at most 512.
        """
        data = ffi.from_buffer("uint8_t[]", words)
        count = len(data) // 4 - start
        used = lib.cm_config_feed(self._port, data + 4 * start, count, swapped, self._events, _BATCH, self._made)
        rows = ffi.buffer(self._events, self._made[0] * _ROW.size)
        return int(used), [Event._make(row) for row in _ROW.iter_unpack(rows)]

    @property
    def phase(self) -> int:
        """0 out of sync, 1 inside a packet, 2 in sync between packets, 3 after a fault."""
        return int(lib.cm_config_phase(self._port))

    @property
    def position(self) -> int:
        """Words consumed since the reset."""
        return int(self._port.position)

    @property
    def far(self) -> int:
        """The frame address that was written last."""
        return int(self._port.far)

    @property
    def head(self) -> tuple[int, ...]:
        """The first words (at most one frame) of the newest FDRI run."""
        return tuple(self._port.head[0 : self._port.head_count])

# SPDX-License-Identifier: Apache-2.0
"""Packets of the local data plane (csrc/client/cm_plane_wire.h, docs/protocol.md), without sockets."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

from cm.errors import InvalidRequest
from cm.frozen import dataclass

SOCKET = "data"  # the socket's name in the runtime folder
PACKET_MAX = 4096
SLOTS_MAX = 256
FDS_MAX = 64

NAME_MAX = 256  # bytes of a register's name, with its field
OPEN, RELEASE, SUBMIT, PING, LEAVE, READ = 1, 2, 3, 4, 5, 6
GEOMETRY, SLOTS, FRAME, GRANT, DONE, PONG, STOPPED, LATE, LABEL, REFUSED, GENERATION, ADDRESS = range(16, 28)
WINDOW, REVOKED, REGISTERS, VALUE, ELSEWHERE, FAILED = range(28, 34)
OPEN_EXCLUSIVE, OPEN_WAIT = 16, 32  # of windows
COHERENT, WRITABLE, CYCLIC = 1, 2, 4

DESCRIPTOR = struct.Struct("=HBBIQQQ")
_GEOMETRY = struct.Struct("=QQIIII8I16s")
DIMENSIONS = 8


class Descriptor(NamedTuple):
    """``struct cm_plane_descriptor``: 32 bytes, at the beginning of every packet."""

    slot: int = 0
    kind: int = 0
    flags: int = 0
    offset: int = 0
    length: int = 0
    sequence: int = 0
    timestamp_ns: int = 0

    def pack(self) -> bytes:
        """The bytes."""
        return DESCRIPTOR.pack(*self)


class Purpose(IntEnum):
    """What a connection is opened for: exactly one of these, which the flags of OPEN say (beside those of windows)."""

    READ = 0  # the frames of a stream
    WRITE = 1  # frames to a stream
    ECHO = 2  # memory that comes back at once, for measuring
    ALLOCATE = 4  # memory for masters in the PL
    WINDOW = 8  # the registers of a module or region, mapped
    WRITABLE_WINDOW = 9
    REGISTERS = 64  # reads of registers by name
    TRANSFER = 128  # transfers from or into memory of ALLOCATE, on a stream that is nobody else's meanwhile


_WINDOWS = (Purpose.WINDOW, Purpose.WRITABLE_WINDOW)
_NAMED = (Purpose.READ, Purpose.WRITE, Purpose.TRANSFER, *_WINDOWS)


@dataclass(frozen=True, slots=True)
class Open:
    """What a client wants; `name` is that of a stream, or of whose registers it maps.

    A window is `exclusive` where others may not write beside it; with `wait` it comes when the module is there.
    `raw`, which is not sent: pixels as they lie in memory, whatever the stream's format.
    """

    name: str
    purpose: Purpose = Purpose.READ
    depth: int = 0
    length: int = 0
    lease: str = ""
    raw: bool = False
    exclusive: bool = False
    wait: bool = False


@dataclass(frozen=True, slots=True)
class Geometry:
    """``struct cm_plane_geometry``: the form of the frames that follow; `stride` 0: no gaps between lines."""

    slot_length: int
    frame_length: int = 0
    coherent: bool = True
    writable: bool = False
    cyclic: bool = False
    depth: int = 0
    stride: int = 0
    shape: tuple[int, ...] | None = None
    dtype: str = "uint8"
    stream: str = ""
    config_name: str = ""
    mode: str = ""
    format: str = ""  # of pixels, as in the runtime schema; a fourth name, which older readers leave alone


def encode_open(wanted: Open) -> bytes:
    """The first packet of a client. Raises InvalidRequest for what no packet can hold."""
    flags = wanted.purpose | (OPEN_EXCLUSIVE if wanted.exclusive else 0) | (OPEN_WAIT if wanted.wait else 0)
    text = f"{wanted.name}\0{wanted.lease}" if wanted.lease else wanted.name
    try:
        return Descriptor(wanted.depth, OPEN, flags, length=wanted.length).pack() + text.encode()
    except struct.error:
        raise InvalidRequest(
            f"stream {wanted.name!r}: a depth of {wanted.depth}, {wanted.length} bytes: not below 0, and whole"
        ) from None


def decode_open(packet: bytes) -> Open:
    """Raises InvalidRequest."""
    head = _head(packet)
    if head.kind != OPEN:
        raise InvalidRequest("the first packet on the data socket must be an OPEN")
    exclusive, wait = bool(head.flags & OPEN_EXCLUSIVE), bool(head.flags & OPEN_WAIT)
    try:
        purpose = Purpose(head.flags & ~(OPEN_EXCLUSIVE | OPEN_WAIT))
    except ValueError:
        raise InvalidRequest(f"an OPEN has one purpose, and the flags {head.flags:#x} are that of none") from None
    try:
        name, _, lease = packet[DESCRIPTOR.size :].decode().partition("\0")
    except UnicodeDecodeError:
        raise InvalidRequest("the stream's name is not UTF-8") from None
    if (exclusive or wait) and purpose not in _WINDOWS:
        raise InvalidRequest("only a window can be exclusive, or be waited for")
    if name and purpose not in _NAMED:
        raise InvalidRequest(f"{name!r} names nothing: an OPEN for {purpose.name.lower()} has no name")
    return Open(name, purpose, head.slot, head.length, lease, exclusive=exclusive, wait=wait)


def encode_geometry(geometry: Geometry) -> bytes:
    """A GEOMETRY packet. Raises InvalidRequest for what no packet can hold."""
    shape = geometry.shape or ()
    if len(shape) > DIMENSIONS or len(geometry.dtype.encode()) > 15:
        raise InvalidRequest(f"a frame of shape {shape} {geometry.dtype}: at most {DIMENSIONS} dimensions go")
    flags = (
        (COHERENT if geometry.coherent else 0)
        | (WRITABLE if geometry.writable else 0)
        | (CYCLIC if geometry.cyclic else 0)
    )
    body = _GEOMETRY.pack(
        geometry.slot_length,
        geometry.frame_length,
        flags,
        geometry.depth,
        geometry.stride,
        len(shape),
        *shape,
        *(0,) * (DIMENSIONS - len(shape)),
        geometry.dtype.encode(),
    )
    names = encode_names(geometry.stream, geometry.config_name, geometry.mode)
    names += encode_names(geometry.format) if geometry.format else b""
    return Descriptor(kind=GEOMETRY).pack() + body + names


def decode_geometry(packet: bytes) -> Geometry:
    """Raises InvalidRequest."""
    end = DESCRIPTOR.size + _GEOMETRY.size
    if len(packet) < end:
        raise InvalidRequest("a GEOMETRY packet is too short")
    slot, frame, flags, depth, stride, dimensions, *rest = _GEOMETRY.unpack_from(packet, DESCRIPTOR.size)
    if dimensions > DIMENSIONS:
        raise InvalidRequest(f"a GEOMETRY packet of {dimensions} dimensions; at most {DIMENSIONS} go")
    stream, config_name, mode, form = decode_names(packet[end:], 4)
    return Geometry(
        slot,
        frame,
        bool(flags & COHERENT),
        bool(flags & WRITABLE),
        bool(flags & CYCLIC),
        depth,
        stride,
        tuple(rest[:dimensions]) or None,
        rest[-1].rstrip(b"\0").decode("ascii", "replace"),
        stream,
        config_name,
        mode,
        form,
    )


class WindowPages(NamedTuple):
    """What a WINDOW packet says: where the pages begin, how many bytes they have, and whose registers they are."""

    address: int
    length: int
    writable: bool
    region: str  # "static": outside all regions
    module: str
    config_name: str
    mode: str
    lease: str  # that goes with an exclusive one


def encode_window(pages: WindowPages) -> bytes:
    """A WINDOW packet; a descriptor of the pages goes with it, and one of a `Config` message of the registers."""
    flags = WRITABLE if pages.writable else 0
    return Descriptor(0, WINDOW, flags, 0, pages.length, pages.address).pack() + encode_names(*pages[3:])


def decode_window(packet: bytes) -> WindowPages:
    """Raises InvalidRequest."""
    head = _head(packet)
    names = [*(part.decode("utf-8", "replace") for part in packet[DESCRIPTOR.size :].split(b"\0")), *[""] * 5][:5]
    return WindowPages(head.sequence, head.length, bool(head.flags & WRITABLE), *names)


def encode_revoked(reason: int, config_name: str, mode: str) -> bytes:
    """A REVOKED packet: why a window ended, and the mode that the board is in, or goes to."""
    return Descriptor(kind=REVOKED, flags=reason).pack() + encode_names(config_name, mode)


def decode_revoked(packet: bytes) -> tuple[int, str, str]:
    """Reason, configuration, mode. Raises InvalidRequest."""
    config_name, mode, _ = decode_names(packet[DESCRIPTOR.size :])
    return _head(packet).flags, config_name, mode


def encode_label(stream: str, config_name: str, mode: str) -> bytes:
    """A LABEL packet: frames from here on are of this mode."""
    return Descriptor(kind=LABEL).pack() + encode_names(stream, config_name, mode)


def encode_refused(code: str, message: str) -> bytes:
    """A REFUSED packet."""
    text = f"{code}\0{message}".encode()[: PACKET_MAX - DESCRIPTOR.size]
    return Descriptor(kind=REFUSED).pack() + text


def decode_refused(packet: bytes) -> tuple[str, str]:
    """Code and sentence."""
    code, _, message = packet[DESCRIPTOR.size :].decode("utf-8", "replace").partition("\0")
    return code, message


def encode_names(*names: str) -> bytes:
    """Names, each with its NUL."""
    return b"".join(name.encode() + b"\0" for name in names)


def decode_names(text: bytes, count: int = 3) -> list[str]:
    """Three names: stream, configuration, mode; and, of a GEOMETRY, the format."""
    return [part.decode("utf-8", "replace") for part in [*text.split(b"\0"), *[b""] * count][:count]]


def _head(packet: bytes) -> Descriptor:
    if len(packet) < DESCRIPTOR.size:
        raise InvalidRequest(f"a packet on the data socket has at least {DESCRIPTOR.size} bytes")
    return Descriptor(*DESCRIPTOR.unpack_from(packet))

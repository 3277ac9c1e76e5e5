# SPDX-License-Identifier: Apache-2.0
"""What a client sends to the data plane (C): it is served or hung up on, and the next one is served as ever.

The C code is not instrumented, so this is chance, not search.
"""

from __future__ import annotations

import mmap
import os
import socket

from pieces import join, split

from cm.device.native import plane as native
from cm.device.native import reads
from cm.wire import plane_packets as wire
from cm.wire.plane_packets import Descriptor, Geometry

PACKAGES = ("cm.wire.plane_packets",)
MAX_LENGTH = 4096

_PLANE = native.new()
_READS = reads.new()
_LENGTH = mmap.PAGESIZE
_SETUP = native.Setup(True, False, False, 2, _LENGTH, *[0] * 6)
_GEOMETRY = wire.encode_geometry(Geometry(_LENGTH, _LENGTH, writable=True, depth=2, shape=(_LENGTH,), stream="echo"))
_HUNG = 60.0  # seconds


def seeds() -> list[bytes]:
    submit = [Descriptor(slot, wire.SUBMIT, length=64, sequence=slot).pack() for slot in (0, 1)]
    return [
        join(submit),
        join([Descriptor(0, wire.RELEASE).pack(), Descriptor(0, wire.PING, sequence=9).pack()]),
        join([*submit, Descriptor(0, wire.LEAVE).pack()]),
        join([wire.encode_open(wire.Open("camera"))]),
        join(
            [
                Descriptor(kind=wire.READ, sequence=3).pack() + name
                for name in (b"led", b"", b"led.blink", b"\xff" * 257)
            ]
        ),
    ]


def one(data: bytes) -> None:
    _read(split(data))
    _talk(split(data))
    good = _talk([Descriptor(0, wire.PING, sequence=5).pack()], until=wire.PONG)
    assert good is not None
    assert Descriptor(*wire.DESCRIPTOR.unpack_from(good)).sequence == 5


def _read(packets: list[bytes]) -> None:
    """A client that reads registers, of which there are none; the next one is told so."""
    for sent in (packets, [Descriptor(kind=wire.READ, sequence=5).pack() + b"led"]):
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.settimeout(_HUNG)
        with ours:
            reads.adopt(_READS, theirs.detach(), os.getpid())
            _send(ours, sent)
            if sent is not packets:
                assert Descriptor(*wire.DESCRIPTOR.unpack_from(_until(ours, wire.ELSEWHERE))).sequence == 5


def _talk(packets: list[bytes], until: int | None = None) -> bytes | None:
    """A client's whole life on a stream of its own; its last packet if it is of that kind."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.settimeout(_HUNG)
    stream = native.start(_PLANE, None, _SETUP)
    memory = [os.memfd_create("fuzz", os.MFD_ALLOW_SEALING) for _ in range(2)]
    try:
        for fd in memory:
            os.ftruncate(fd, _LENGTH)
            native.add_slot(_PLANE, stream, fd, 0)
        native.attach(_PLANE, native.adopt(_PLANE, theirs.detach()), stream, 2, _GEOMETRY)
        with ours:
            _send(ours, packets)
            found = _until(ours, until) if until is not None else None
        native.settle(_PLANE)
        return found
    finally:
        native.stop(_PLANE, stream, 0)
        while native.take(_PLANE) is not None:
            pass
        for fd in memory:
            os.close(fd)


def _send(sock: socket.socket, packets: list[bytes]) -> None:
    try:
        for packet in packets:
            sock.send(packet)
    except (BrokenPipeError, ConnectionResetError):
        return  # hung up on


def _until(sock: socket.socket, kind: int) -> bytes:
    while True:
        packet, fds, _, _ = socket.recv_fds(sock, wire.PACKET_MAX, wire.FDS_MAX)
        for fd in fds:
            os.close(fd)
        assert packet, "hung up on a client that keeps the rules"
        if Descriptor(*wire.DESCRIPTOR.unpack_from(packet)).kind == kind:
            return packet

# SPDX-License-Identifier: Apache-2.0
"""Bitstreams: inspected, or refused with a BitstreamError; what can be converted comes back byte for byte.

One that is good can be moved, and back. The simulated port takes them in any pieces.
"""

from __future__ import annotations

from cm.formats.bitstream import (
    BitstreamError,
    Container,
    FrameAddress,
    FrameRun,
    assemble,
    convert,
    device_by_name,
    inspect,
    open_image,
)
from cm.formats.bitstream.memory import frames_in
from cm.formats.bitstream.relocate import readdressed
from cm.simulation.software.hardware.configuration_port import ConfigPort

PACKAGES = ("cm.formats.bitstream", "cm.simulation.software.hardware")
MAX_LENGTH = 8192

_DEVICE = device_by_name("xc7z020")
_HALF = 1 << 22  # of a frame address: a column of the other half


def seeds() -> list[bytes]:
    bit = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 26), bytes(404))])
    header = bytearray(0x8C0)
    header[0x24:0x28] = b"XNLX"
    swapped = convert(bit, Container.BIN_SWAPPED)
    return [bit, swapped, convert(bit, Container.BIN_STRAIGHT), bytes(header) + swapped]


def one(data: bytes) -> None:
    assert _DEVICE is not None
    port = ConfigPort(_DEVICE)
    half = len(data) // 8 * 4
    port.feed(data[:half])
    port.feed(data[half:])
    try:
        image = open_image(data)
        inspect(data).to_json()
        other = convert(data, Container.BIN_STRAIGHT)
    except BitstreamError:
        return
    if image.container is Container.BIT:
        assert convert(other, Container.BIT, image.header) == data
    try:
        columns = {address & ~0x7F for address in frames_in(data)[1]}
        moves = {column: column ^ _HALF for column in columns}
        there = readdressed(data, moves)
    except BitstreamError:
        return
    assert readdressed(there, {there: here for here, there in moves.items()}) == data

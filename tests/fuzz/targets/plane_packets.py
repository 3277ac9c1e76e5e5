# SPDX-License-Identifier: Apache-2.0
"""Packets of the local data plane, as manager and client read them: what was meant, or InvalidRequest."""

from __future__ import annotations

from contextlib import suppress

from cm.errors import InvalidRequest
from cm.wire import plane_packets as plane
from cm.wire.plane_packets import Geometry, Open, Purpose

PACKAGES = ("cm.wire.plane_packets",)
MAX_LENGTH = 4096


def seeds() -> list[bytes]:
    geometry = Geometry(8192, 4096, depth=4, shape=(64, 64), stream="camera", config_name="camera", mode="edge")
    return [
        plane.encode_open(Open("camera", depth=2)),
        plane.encode_open(Open("to_pl", Purpose.WRITE, lease="1")),
        plane.encode_open(Open("", Purpose.ECHO, length=4096)),
        plane.encode_geometry(geometry),
        plane.encode_label("camera", "camera", "edge"),
        plane.encode_refused("no_slots", "all slots are taken"),
    ]


def one(data: bytes) -> None:
    with suppress(InvalidRequest):
        assert plane.decode_open(plane.encode_open(plane.decode_open(data))) == plane.decode_open(data)
    with suppress(InvalidRequest):
        geometry = plane.decode_geometry(data)
        if "\ufffd" not in geometry.dtype:  # which takes more room than the byte that could not be read
            assert plane.decode_geometry(plane.encode_geometry(geometry)) == geometry
    with suppress(InvalidRequest):
        plane.decode_refused(data)
    with suppress(InvalidRequest):
        plane.decode_names(data)

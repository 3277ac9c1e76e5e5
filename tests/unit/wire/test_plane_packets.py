# SPDX-License-Identifier: Apache-2.0
"""Packets of the data socket: they are read as they were written, and nonsense is refused."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cm.errors import InvalidRequest
from cm.wire import plane_packets as plane
from cm.wire.plane_packets import Descriptor, Geometry, Open, Purpose

HEADER = Path(__file__).resolve().parents[3] / "csrc" / "client" / "cm_plane_wire.h"
NAMES = st.text(st.sampled_from("aZ_-0 é漢🎥"), max_size=40)
U64 = st.integers(0, 2**64 - 1)
U32 = st.integers(0, 2**32 - 1)


def test_a_descriptor_has_32_bytes() -> None:
    assert len(Descriptor().pack()) == plane.DESCRIPTOR.size == 32


KINDS = ["OPEN", "RELEASE", "SUBMIT", "PING", "GEOMETRY", "SLOTS", "FRAME", "GRANT", "DONE", "PONG", "STOPPED"]
FLAGS = ["LATE", "LABEL", "REFUSED", "OPEN_EXCLUSIVE", "OPEN_WAIT", "COHERENT", "WRITABLE", "CYCLIC"]
LIMITS = ["SLOTS_MAX", "FDS_MAX", "PACKET_MAX"]


@pytest.mark.parametrize("name", [*KINDS, *FLAGS, *LIMITS])
def test_numbers_are_those_of_the_header(name: str) -> None:
    found = re.search(rf"^#define CM_PLANE_{name}[\s\\]+(\d+)", HEADER.read_text(), re.MULTILINE)
    assert found is not None
    assert int(found[1]) == getattr(plane, name)


PURPOSES = [("WRITE", 1), ("ECHO", 2), ("ALLOCATE", 4), ("WINDOW", 8), ("REGISTERS", 64)]


@pytest.mark.parametrize(("flag", "purpose"), PURPOSES)
def test_purposes_are_the_flags_of_the_header(flag: str, purpose: int) -> None:
    found = re.search(rf"^#define CM_PLANE_OPEN_{flag}[\s\\]+(\d+)", HEADER.read_text(), re.MULTILINE)
    assert found is not None
    assert int(found[1]) == Purpose[flag] == purpose


@given(st.builds(Open, NAMES, st.sampled_from([Purpose.READ, Purpose.WRITE]), st.integers(0, 65535), U64))
def test_an_open_is_read_as_it_was_written(wanted: Open) -> None:
    assert plane.decode_open(plane.encode_open(wanted)) == wanted


EXCLUSIVE, WAIT = 16, 32
WINDOWS = {8 | write | option for write in (0, 1) for option in (0, EXCLUSIVE, WAIT, EXCLUSIVE | WAIT)}


@pytest.mark.parametrize("flags", range(256))
def test_an_open_has_exactly_one_purpose(flags: int) -> None:
    packet = plane.Descriptor(kind=plane.OPEN, flags=flags).pack()
    if flags in {0, 1, 2, 4, 64, 128, *WINDOWS}:
        wanted = plane.decode_open(packet)
        assert wanted == Open("", Purpose(flags & 207), exclusive=bool(flags & EXCLUSIVE), wait=bool(flags & WAIT))
        assert plane.encode_open(wanted) == packet
    else:
        with pytest.raises(InvalidRequest, match=r"has one purpose|only a window"):
            plane.decode_open(packet)


@pytest.mark.parametrize("purpose", [Purpose.ECHO, Purpose.ALLOCATE, Purpose.REGISTERS])
def test_an_open_that_names_nothing_has_no_name(purpose: Purpose) -> None:
    with pytest.raises(InvalidRequest, match=f"'camera' names nothing: an OPEN for {purpose.name.lower()} has no name"):
        plane.decode_open(plane.encode_open(Open("camera", purpose)))


@given(
    st.builds(
        Geometry,
        slot_length=U64,
        frame_length=U64,
        coherent=st.booleans(),
        writable=st.booleans(),
        cyclic=st.booleans(),
        depth=U32,
        stride=U32,
        shape=st.none() | st.lists(U32, min_size=1, max_size=8).map(tuple),
        dtype=st.sampled_from(["uint8", "complex128"]),
        stream=NAMES,
        config_name=NAMES,
        mode=NAMES,
    )
)
def test_a_geometry_is_read_as_it_was_written(geometry: Geometry) -> None:
    assert plane.decode_geometry(plane.encode_geometry(geometry)) == geometry


@given(NAMES, NAMES)
def test_a_refusal_is_read_as_it_was_written(code: str, message: str) -> None:
    assert plane.decode_refused(plane.encode_refused(code, message)) == (code, message)


@given(st.binary(max_size=200))
def test_nonsense_raises_our_error_or_is_read(packet: bytes) -> None:
    for decode in (plane.decode_open, plane.decode_geometry):
        with suppress(InvalidRequest):
            decode(packet)


def test_a_frame_of_nine_dimensions_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="8 dimensions"):
        plane.encode_geometry(Geometry(1, shape=(1,) * 9))

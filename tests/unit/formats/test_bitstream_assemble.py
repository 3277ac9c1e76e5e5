# SPDX-License-Identifier: Apache-2.0
"""Assembled bitstreams: the same arguments give the same bytes. A change of the assembler changes the hashes here."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from bitstream_support import HERE, compressed, frames, small, two_sections

from cm.formats.bitstream import (
    CrcResult,
    FrameAddress,
    FrameRun,
    assemble,
    assemble_module,
    default_footprint,
    inspect,
    open_image,
)
from cm.formats.bitstream.assemble import StreamWriter, assemble_stream
from cm.formats.bitstream.container import BitHeader
from cm.formats.bitstream.errors import UnknownDevice
from cm.formats.bitstream.inspection_report import Footprint
from cm.formats.bitstream.simulated_module import ModuleIdentity, identify_bytes
from cm.formats.bitstream.verify import Expectation, expect_module, expect_static
from cm.schema import load
from cm.schema.model import FrameRange, StaticIdentity

CAMERA = Path(__file__).resolve().parents[3] / "cm" / "data" / "camera" / "camera.yaml"


def short(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


@pytest.mark.parametrize(
    ("make", "wanted"),
    [
        (small, "07be157ee25850c9"),
        (lambda: small(partial=False), "947a890f533b9b15"),
        (lambda: small(crc=False), "a5a0a282b0917e74"),
        (compressed, "2523e3df641c2bf7"),
        (two_sections, "cb66b654b53cbf58"),
        (lambda: assemble("xck26", [FrameRun(HERE, bytes(93 * 4))]), "ea2e505bcbba6eae"),
        (lambda: assemble_stream("xc7z020", [[FrameRun(HERE, frames(1))]]), "0e1f54b2593c615e"),
        (lambda: assemble_stream("xc7z020", [[FrameRun(HERE, frames(1))]], partial=False), "3295689fcee7113d"),
        (lambda: assemble_module("edge"), "3d1701c83a936f92"),
        (lambda: assemble_module("edge", model="sobel", region_index=1, size=100_000), "722fcedec15604a1"),
        (lambda: assemble_module("edge", device="xck26", size=1), "90b6bec9176c56ec"),
    ],
    ids=["small", "full", "no crc", "compressed", "sections", "ultrascale", "stream", "full stream", "module", "model",
         "ultrascale module"],
)  # fmt: skip
def test_the_same_arguments_give_the_same_bytes_while_the_assembler_is_not_changed(
    make: Callable[[], bytes], wanted: str
) -> None:
    assert short(make()) == wanted


@pytest.mark.parametrize(("count", "columns"), [(40, [2, 3]), (72, [2, 3]), (73, [2, 3, 4]), (9999, [*range(2, 10)])])
def test_a_small_module_fills_no_more_columns_of_its_region_than_it_needs(count: int, columns: list[int]) -> None:
    found = inspect(assemble_module("edge", footprint=[FrameRange(0, 0, 2, 9)], size=404 * count)).footprint
    assert [item.column for item in found] == columns


@pytest.mark.parametrize(
    ("address", "told"),
    [
        (FrameAddress(8, 0, 0), "8 needs over 3 bits"),
        (FrameAddress(0, 64, 0), "64 needs over 6 bits"),
        (FrameAddress(0, 0, 1024), "1024 needs over 10 bits"),
        (FrameAddress(0, 0, 0, 128), "128 needs over 7 bits"),
        (FrameAddress(0, 0, -1), "-1 needs over 10 bits"),
    ],
)
def test_an_address_that_the_register_cannot_hold_is_refused(address: FrameAddress, told: str) -> None:
    with pytest.raises(ValueError, match=f"does not fit a frame address of .*{told}"):
        assemble("xc7z020", [FrameRun(address, frames(1))])


def test_a_device_that_is_not_known_is_named() -> None:
    with pytest.raises(UnknownDevice, match="device 'xc7z999' has no IDCODE"):
        assemble("xc7z999", [])


@pytest.mark.parametrize(("runs", "sections"), [(1, 2), (1, 0), (0, 1)])
def test_there_are_at_most_as_many_sections_as_runs(runs: int, sections: int) -> None:
    with pytest.raises(ValueError, match=f"^{runs} runs cannot fill {sections} sections$"):
        assemble("xc7z020", [FrameRun(HERE, frames(1))] * runs, sections=sections)


@pytest.mark.parametrize(("runs", "wanted"), [(3, [1, 2]), (4, [1, 1, 2]), (5, [1, 2, 2])])
def test_runs_are_spread_in_order_over_as_many_sections_as_are_asked_for(runs: int, wanted: list[int]) -> None:
    data = [FrameRun(FrameAddress(0, 0, 26 + at), frames(1)) for at in range(runs)]
    report = inspect(assemble("xc7z020", data, sections=len(wanted)))
    assert [section.frames for section in report.sections] == wanted
    assert report.problems == ()


def test_a_header_has_what_it_was_given_and_of_the_designs_name_what_its_form_can_hold() -> None:
    given = {"part": "7z020clg400", "date": "2025/02/03", "time": "04:05:06", "version": "9", "user_id": 0xC0FFEE}
    header = open_image(small(design="!a b;c=d:~\x7f", **given)).header
    fields = (("UserID", "0X00C0FFEE"), ("PARTIAL", "TRUE"), ("Version", "9"))
    assert header == BitHeader("!a_b_c=d:~_", fields, "7z020clg400", "2025/02/03", "04:05:06")


@pytest.mark.parametrize(("count", "begin"), [(2047, [0x300047FF]), (2048, [0x30004000, 0x50000800])])
def test_a_write_that_type_1_cannot_hold_is_of_type_2(count: int, begin: list[int]) -> None:
    writer = StreamWriter()
    writer.bulk(2, bytes(4 * count))
    assert struct.unpack(f">{len(begin)}I", writer.words[: -4 * count]) == tuple(begin)


def test_a_module_goes_where_its_arguments_say() -> None:
    report = inspect(assemble_module("edge", device="xck26", region_index=1, part="xck26-x", crc=False, size=1))
    assert (report.part, report.crc, report.design) == ("xck26-x", CrcResult.ABSENT, "edge")
    assert report.footprint == (Footprint(0, 1, 0, 2),)


@pytest.mark.parametrize(
    ("index", "device", "size", "wanted"),
    [
        (0, "xc7z020", 404 * 42, (0, 0)),
        (0, "xc7z020", 404 * 42 + 1, (0, 1)),
        (1, "xc7z020", 1, (32, 0)),
        (2, "xc7z020", 1, (33, 0)),
        (3, "xc7z020", 404 * 36 + 1, (3, 1)),  # more regions than rows: there columns of logic
        (1, "xck26", 372 * 16 + 1, (1, 1)),
        (0, "xck26", 1 << 30, (0, 1023)),
    ],
)
def test_a_region_that_states_no_frames_has_as_many_columns_of_its_row_as_its_size_needs(
    index: int, device: str, size: int, wanted: tuple[int, int]
) -> None:
    assert default_footprint(index, device, size) == (FrameRange(0, wanted[0], 0, wanted[1]),)


def test_names_that_do_not_fit_a_frame_are_refused_with_their_limit() -> None:
    assert assemble_module("x" * 128)
    with pytest.raises(ValueError, match=r"module 'x.*together over 256 bytes$"):
        assemble_module("x" * 128, model="y" * 129)


def test_a_static_image_and_a_module_must_match_their_schema() -> None:
    config = replace(
        load(CAMERA), sha256="0" * 64, idcode=0x123, allow_encrypted=True, static=StaticIdentity(user_id=0xC0FFEE)
    )
    expected = Expectation("xc7z020", 0x123, False, (), 0xC0FFEE, True, "0" * 64)
    assert expect_static(config) == expected
    assert expect_static(replace(config, static=None)) == replace(expected, user_id=None)
    module = replace(config.modules["edge"], sha256="1" * 64)
    region, learned = config.regions[module.region], (FrameRange(0, 0, 1, 2),)
    of_module = replace(expected, partial=True, footprint=learned, allow_encrypted=False, sha256="1" * 64)
    assert expect_module(config, module, learned) == of_module
    own = replace(region, footprint=(FrameRange(0, 0, 3, 4),), allow_encrypted=True)
    stated = replace(config, regions={region.name: own}, static=None)
    of_module = replace(of_module, footprint=own.footprint, user_id=None, allow_encrypted=True)
    assert expect_module(stated, module, learned) == of_module


def test_a_frame_names_its_module_unless_one_byte_of_either_name_is_another() -> None:
    frame = assemble_module("edge", model="sobel", size=1)
    begin, name, model = frame.index(b"CM-RM"), frame.rindex(b"edge"), frame.rindex(b"sobel")
    assert identify_bytes(frame[begin:]) == ModuleIdentity("edge", "sobel")
    for at in (name, model):
        damaged = frame[:at] + bytes([frame[at] ^ 1]) + frame[at + 1 :]
        assert identify_bytes(damaged[begin:]) is None
    strange = hashlib.sha256(b"\xff\0\xfe").digest() + struct.pack(">HH", 1, 1) + b"\xff\xfe"
    assert identify_bytes(frame[begin:][:8] + strange) == ModuleIdentity("\ufffd", "\ufffd")
    assert identify_bytes(frame[begin:][:8] + strange[:-1]) is None
    assert identify_bytes(frame[begin:][:20]) is None
    assert identify_bytes(frame[begin + 1 :]) is None

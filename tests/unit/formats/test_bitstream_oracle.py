# SPDX-License-Identifier: Apache-2.0
"""The parser, the assembler and the tables compared with independent programs and data: Project X-Ray's.

They come from Debian's sid, fetched once into the user's cache; without them, the tests are skipped.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from xray_oracle import DATABASE, PARTS, fetched_or_skipped, frames_read, part, read_bits, run

from cm.design.debian_packages import PackageTree
from cm.formats.bitstream import Container, FrameAddress, FrameRun, assemble, convert, inspect
from cm.formats.bitstream.geometry import decode_far, encode_far, geometry_of
from cm.formats.bitstream.idcodes import Family, device_by_idcode, device_by_name

pytestmark = pytest.mark.open

WORDS = 101


@pytest.fixture(scope="module")
def xray() -> PackageTree:
    return fetched_or_skipped()


def bits_of(far: int, frame: bytes) -> Iterator[tuple[int, int, int]]:
    """The bits that are set in a frame, except those of its checksum, which bitread leaves out."""
    for index, word in enumerate(struct.unpack(f">{WORDS}I", frame)):
        for bit in range(32):
            if word >> bit & 1 and not (index == 50 and bit < 13):
                yield far, index, bit


def noise(count: int, seed: str) -> bytes:
    return hashlib.shake_128(seed.encode()).digest(count * 4 * WORDS)


@pytest.mark.parametrize("device", PARTS)
def test_bitread_finds_the_bits_that_we_assembled_where_we_put_them(
    xray: PackageTree, device: str, tmp_path: Path
) -> None:
    family = Family.SERIES7
    places = [FrameAddress(0, 0, 3), FrameAddress(0, 32, 7, 5), FrameAddress(1, 0, 1, 9), FrameAddress(1, 32, 2)]
    runs, expected = [], set()
    for number, address in enumerate(places):
        data = noise(3, f"{device} {number}")
        runs.append(FrameRun(address, data + bytes(4 * WORDS)))
        for offset in range(3):
            far = encode_far(
                FrameAddress(address.block_type, address.row, address.column, address.minor + offset), family
            )
            expected |= set(bits_of(far, data[offset * 404 : offset * 404 + 404]))
    assert read_bits(xray, device, assemble(device, runs), tmp_path) == expected


def test_a_run_over_columns_ends_where_bitread_sees_it_end(xray: PackageTree, tmp_path: Path) -> None:
    """The last column of a run, by our table of columns, is the one that bitread puts its last frame into."""
    geometry = geometry_of("xc7z020")
    assert geometry is not None
    row = geometry.row(0, 32)
    assert row is not None
    for first in (0, 1, 5, 33, 60):
        count = row.starts[first + 3] - row.starts[first]
        run_ = FrameRun(FrameAddress(0, 32, first), (bytes(403) + b"\1") * count + bytes(404))
        report = inspect(assemble("xc7z020", [run_]))
        found = {
            decode_far(far, Family.SERIES7)
            for far, _, _ in read_bits(xray, "xc7z020", assemble("xc7z020", [run_]), tmp_path)
        }
        assert {item.last for item in report.footprint} == {first + 2} == {max(address.column for address in found)}
        assert len(found) == count


@pytest.mark.parametrize("device", PARTS)
def test_a_bitstream_of_prjxray_is_read_whole(xray: PackageTree, device: str, tmp_path: Path) -> None:
    """xc7frames2bit writes every frame of a device; what we read is what it was given."""
    name = PARTS[device].partition("/")[2]
    given = {encode_far(FrameAddress(0, 32, 4, minor), Family.SERIES7): noise(1, f"{minor}") for minor in range(5)}
    lines = [
        f"0x{far:08x} " + ",".join(f"0x{word:08x}" for word in struct.unpack(">101I", data))
        for far, data in given.items()
    ]
    (tmp_path / "in.frm").write_text("\n".join(lines) + "\n")
    options = ["--part_name", name, "--part_file", str(part(xray, device)), "--frm_file", str(tmp_path / "in.frm")]
    run(xray, "xc7frames2bit", *options, "--output_file", str(tmp_path / "out.bit"))
    report = inspect(tmp_path / "out.bit")
    assert report.problems == ()
    assert (report.device, report.partial, report.looks_partial) == (device, False, False)
    assert frames_read(tmp_path / "out.bit", device).keys() >= given.keys()
    read = frames_read(tmp_path / "out.bit", device)
    assert {far: masked(data) for far, data in read.items() if any(masked(data))} == {
        far: masked(data) for far, data in given.items()
    }
    swapped = convert(tmp_path / "out.bit", Container.BIN_SWAPPED)
    assert inspect(swapped).frames == report.frames


def masked(frame: bytes) -> bytes:
    """A frame without its checksum, which xc7frames2bit computes."""
    (word,) = struct.unpack_from(">I", frame, 200)
    return frame[:200] + struct.pack(">I", word & ~0x1FFF) + frame[204:]


def test_columns_and_idcodes_are_those_of_the_database(xray: PackageTree) -> None:
    compared = set()
    for path in sorted(xray.path(DATABASE).glob("*/*/part.json")):
        found = json.loads(path.read_text())
        device = device_by_idcode(found["idcode"])
        assert device is not None, path
        assert device == device_by_name(path.parent.name), path
        if device.name in compared or (geometry := geometry_of(device.name)) is None:
            continue
        compared.add(device.name)
        for half, base in (("top", 0), ("bottom", 32)):
            for number, row in found["global_clock_regions"].get(half, {"rows": {}})["rows"].items():
                for block_type, name in enumerate(("CLB_IO_CLK", "BLOCK_RAM")):
                    columns = row["configuration_buses"].get(name, {"configuration_columns": {}})[
                        "configuration_columns"
                    ]
                    ours = geometry.row(block_type, base + int(number))
                    assert ours is not None or not columns
                    for column, shape in columns.items():
                        assert ours is not None
                        assert ours.frames(int(column)) == shape["frame_count"], (path, half, number, name, column)
    assert compared >= {"xc7z010", "xc7z020", "xc7a50t", "xc7a100t", "xc7a200t", "xc7k70t", "xc7s50"}

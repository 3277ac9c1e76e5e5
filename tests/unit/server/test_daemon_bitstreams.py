# SPDX-License-Identifier: Apache-2.0
"""Which files configure a device identically, whatever their container and padding."""

from __future__ import annotations

from pathlib import Path

import pytest
from bitstream_support import HERE, frames, small, two_sections

from cm.formats.bitstream import Container, FrameAddress, FrameRun, assemble, convert
from cm.formats.bitstream.errors import Sha256Mismatch
from cm.manager.inputs import Image
from cm.server.bitstream_and_overlay_files import BitstreamReader, image_of

NOP, ZEROS, DUMMY = b"\x00\x00\x00\x20", bytes(4), b"\xff\xff\xff\xff"


@pytest.fixture
def reader() -> BitstreamReader:
    return BitstreamReader()


def stored(reader: BitstreamReader, folder: Path, data: bytes) -> Image:
    path = folder / "image.bit"
    path.write_bytes(data)
    return image_of(path, reader.inspect(path))


@pytest.mark.parametrize("padding", [b"", NOP, ZEROS, DUMMY, NOP + ZEROS * 3 + DUMMY])
def test_padding_behind_the_stream_changes_nothing(reader: BitstreamReader, tmp_path: Path, padding: bytes) -> None:
    image = stored(reader, tmp_path, small())
    other = tmp_path / "other.bin"
    other.write_bytes(convert(small(), Container.BIN_SWAPPED) + padding)
    for _ in range(2):  # the second time as it is remembered
        assert reader.configures_as(other, image)
        assert reader.has_words_of(other, image) == (not padding)


def test_another_stream_does_not_configure_alike(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, small())
    other = tmp_path / "other.bin"
    other.write_bytes(convert(two_sections(), Container.BIN_SWAPPED))
    assert not reader.configures_as(other, image)
    assert not reader.has_words_of(other, image)


def test_every_section_of_a_stream_counts(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, two_sections())
    runs = [FrameRun(HERE, frames(1, b"others")), FrameRun(FrameAddress(1, 2, 3), frames(2, b"more"))]
    other = tmp_path / "other.bit"
    other.write_bytes(assemble("xc7z020", runs, sections=2))  # differs in its first section alone
    assert not reader.configures_as(other, image)


def test_a_file_that_was_replaced_is_not_read_for_what_was_checked(reader: BitstreamReader, tmp_path: Path) -> None:
    image = stored(reader, tmp_path, small())
    assert reader.read(image) == small()
    image.path.write_bytes(two_sections())
    with pytest.raises(Sha256Mismatch, match="was replaced after it had been checked"):
        reader.read(image)
    assert not reader.has_words_of(image.path, image)

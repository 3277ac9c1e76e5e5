# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import gzip
import re
import struct
from contextlib import suppress
from dataclasses import replace

import pytest
from bitstream_support import HEADER, small, two_sections
from hypothesis import given
from hypothesis import strategies as st

from cm.device.native.bitstream import swap
from cm.formats.bitstream import BitstreamError, Container, Image, convert, inspect, open_image, to_dma_words
from cm.formats.bitstream.container import BitHeader, pack_bit
from cm.formats.bitstream.errors import BadContainer, CannotRelocate, NoSync, Truncated
from cm.formats.bitstream.memory import frames_in
from cm.formats.bitstream.relocate import readdressed

TEXT = st.text("".join(chr(code) for code in range(33, 127) if chr(code) not in ";="), max_size=20)


def partition(first: int, begin: int, length: int, destination: int, padding: int = 0) -> bytes:
    """A partition header: lengths, then offset and attributes from word `first` on, and the check sum."""
    words = [length // 4 + padding, length // 4, length and length // 4 + 16] + [0] * 13
    words[first], words[first + 1] = begin // 4, destination << 4
    words[15] = ~sum(words) & 0xFFFFFFFF
    return struct.pack("<16I", *words)


def boot_image(stream: bytes, encryption: int = 0, partitions: tuple[bytes, ...] = ()) -> bytes:
    """A boot image as bootgen lays it out: header with width word and signature, table, stream, zeros."""
    header = bytearray(0x2800)
    header[0x20:0x24] = bytes.fromhex("665599aa")
    header[0x24:0x28] = b"XNLX"
    struct.pack_into("<II", header, 0x28, encryption, 0xFFFFFFFF)
    struct.pack_into("<I", header, 0x9C, 0xC80)
    table = b"".join(partitions)
    header[0xC80 : 0xC80 + len(table)] = table
    return bytes(header) + stream + bytes(200)


@given(design=TEXT, part=TEXT, date=TEXT, time=TEXT)
def test_bit_header_survives_packing(design: str, part: str, date: str, time: str) -> None:
    header = BitHeader(design, (("UserID", "0"),), part, date, time)
    assert open_image(pack_bit(header, bytes.fromhex("ffffffffaa995566"))).header == header


@given(fields=st.binary(max_size=20).filter(lambda raw: not raw.endswith(bytes(1))))
def test_odd_header_fields_survive_conversion(fields: bytes) -> None:
    original = bytearray(small())
    begin = original.index(b"UserID")
    original[begin : begin + len(fields)] = fields
    data = bytes(original)
    header = open_image(data).header
    assert convert(convert(data, Container.BIN_SWAPPED), Container.BIT, header) == data


@pytest.mark.parametrize("form", [Container.BIN_SWAPPED, Container.BIN_STRAIGHT])
def test_conversion_there_and_back_is_byte_exact(form: Container) -> None:
    original = small()
    there = convert(original, form)
    assert open_image(there).container is form
    assert convert(there, Container.BIT, open_image(original).header) == original
    assert to_dma_words(there) == to_dma_words(original) == swap(convert(original, Container.BIN_STRAIGHT))
    with pytest.raises(BadContainer, match="3 bytes follow the last whole word: the file is damaged"):
        convert(there + b"abc", Container.BIT, open_image(original).header)
    damaged = pack_bit(HEADER, convert(original, Container.BIN_STRAIGHT) + b"ab")
    assert [item.message for item in inspect(damaged).problems] == ["2 bytes follow the last whole word"]


@pytest.mark.parametrize("form", [Container.BIN_SWAPPED, Container.BIN_STRAIGHT])
def test_boot_image_is_opened_behind_its_own_sync_word(form: Container) -> None:
    stream = convert(two_sections(), form)  # as big-endian words it ends with a NOP's zeros
    image = open_image(boot_image(stream))
    assert (image.container, image.offset, bytes(image.stream)) == (Container.BOOTGEN, 0x2800, stream)
    assert convert(boot_image(stream), Container.BIN_STRAIGHT) == convert(two_sections(), Container.BIN_STRAIGHT)
    assert open_image(boot_image(stream) + b"\1").rest == 1


def test_a_boot_image_is_not_moved_to_other_frames() -> None:
    source = boot_image(to_dma_words(small()))
    stay = {far & ~0x7F: far & ~0x7F for far in frames_in(source)[1]}
    with pytest.raises(CannotRelocate, match=r"^boot images are read, not written: give the \.bit or \.bin$"):
        readdressed(source, stay)


@pytest.mark.parametrize("first", [5, 8])  # where Zynq and Zynq UltraScale+ have a partition's offset
@pytest.mark.parametrize(("key", "padding"), [(0, 0), (0, 3), (0xA5C3C5A3, 0)])  # another partition is encrypted
def test_boot_image_with_more_partitions_gives_the_one_for_the_pl(first: int, key: int, padding: int) -> None:
    stream = to_dma_words(small())
    loader = partition(first, 0x2800, 400, 1), partition(first, 0x2C00, 400, 2)  # the second has no stream
    table = *loader, partition(first, 0x3000, len(stream), 2, padding)
    code = stream[:400] + bytes(0x400)  # looks like a stream, but is not for the PL
    image = boot_image(code + bytes(0x800 - len(code)) + stream + b"u-boot" * 100, key, table)
    found = open_image(image)
    assert (found.offset, bytes(found.stream), found.encrypted) == (0x3000, stream, False)
    assert inspect(image).problems == ()


def test_damaged_partition_table_is_not_used() -> None:
    table = bytearray(partition(5, 0x10, 400, 2))
    table[0] ^= 1
    stream = to_dma_words(small())
    image = boot_image(stream, partitions=(bytes(table),))
    assert open_image(image).offset == 0x2800
    assert open_image(image[:0x9C] + bytes.fromhex("00ffffff") + image[0xA0:]).offset == 0x2800


def test_a_boot_image_that_ends_within_its_table_has_no_further_partitions() -> None:
    """Its stream is then looked for behind the header, where there is none either."""
    entry = partition(5, 0x2800, 400, 1)
    for end in (0xC80 + 64 + 1, 0xC80 + 64 + 63, 0xC80 + 1):
        with pytest.raises(NoSync, match="boot image"):
            open_image(boot_image(b"", partitions=(entry, entry))[:end])


@pytest.mark.parametrize(("first", "key", "bit"), [(5, 0xA5C3C5A3, 0), (8, 0, 1 << 7)], ids=["Zynq", "ZynqMP"])
def test_a_partition_that_is_encrypted_has_no_sync_word_and_all_its_zeros(first: int, key: int, bit: int) -> None:
    cipher = b"\x5a" * 400 + bytes(400)
    words = list(struct.unpack("<16I", partition(first, 0x2800, len(cipher), 2)))
    words[0], words[first + 1] = words[0] + 4, words[first + 1] | bit  # encrypted, it is longer
    words[15] = ~sum(words[:15]) & 0xFFFFFFFF
    found = open_image(boot_image(cipher, key, (struct.pack("<16I", *words),)))
    assert (found.encrypted, found.swapped, found.offset, bytes(found.stream)) == (True, True, 0x2800, cipher)
    assert open_image(boot_image(to_dma_words(small()), encryption=key)).encrypted is (key != 0)


@pytest.mark.parametrize(("begin", "more"), [(0x2800, 204), (0x8BC, 200)], ids=["end", "begin"])
def test_a_partition_lies_between_the_header_and_the_end_of_a_boot_image(begin: int, more: int) -> None:
    stream = to_dma_words(small())
    image = boot_image(stream, partitions=(partition(5, 0x2800, len(stream) + 200, 2),))
    assert (open_image(image).offset, bytes(open_image(image).stream)) == (0x2800, stream)
    data = bytearray(boot_image(stream, partitions=(partition(5, begin, len(stream) + more, 2),)))
    data[0x8BC:0x8C4] = bytes.fromhex("665599aa") * 2
    with pytest.raises(NoSync, match="1 partitions"):
        open_image(bytes(data))
    data[0xC80:0xCC0] = partition(5, 0x8C0, 4, 2)
    assert bytes(open_image(bytes(data)).stream) == bytes.fromhex("665599aa")


def test_padding_before_the_sync_word_belongs_to_the_stream_but_nothing_of_the_header() -> None:
    padding, sync = bytes.fromhex("ffffffff000000bb11220044ffffffff"), bytes.fromhex("aa995566")
    for data in (b"\1\2\3\4" + padding + sync, b"\1\2\3\4" + swap(padding + sync)):
        assert open_image(boot_image(data)).offset == 0x2804
    header = bytearray(boot_image(b"")[:0x8C0])
    header[-4:] = padding[:4]
    assert open_image(bytes(header) + padding + sync).offset == 0x8C0


def test_boot_image_without_bitstream_has_no_sync() -> None:
    for end in (None, 0x8C0):
        with pytest.raises(
            NoSync, match=r"^a boot image without a bitstream partition: no sync word after its header$"
        ):
            open_image(boot_image(b"")[:end])
    loader, design, end = partition(5, 0x2800, 400, 1), partition(5, 0x2800, 65540, 2), partition(5, 0, 0, 0)
    data, late = (bytes(zeros) + bytes.fromhex("665599aa") for zeros in (65532, 65536))
    assert open_image(boot_image(data, partitions=(loader,) * 31 + (design,))).offset == 0x2800
    for image, table, count in ((data, [loader] * 32 + [design], 32), (data, [loader, end, design], 1),
                                (late, [design], 1)):  # fmt: skip
        told = f"^a boot image of {count} partitions, none of which is a bitstream for the PL$"
        with pytest.raises(NoSync, match=told):
            open_image(boot_image(image, partitions=tuple(table)))


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "the file is empty"),
        (b"MZ" * 500, r"neither a \.bit header nor a boot image, and no sync word in the first 1000 bytes$"),
        (gzip.compress(small()), "compressed by gzip: unpack it first"),
        (b"PK\x03\x04" + bytes(200), "a zip archive: of an .xsa, cm build collect takes what is in it"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "a pointer of Git LFS instead of the file"),
    ],
)
def test_what_lies_in_the_place_of_a_bitstream_is_named(data: bytes, said: str) -> None:
    with pytest.raises(NoSync, match=f"^{said}"):
        open_image(data)


@pytest.mark.parametrize("container", [Container.BIN_SWAPPED, Container.BIN_STRAIGHT])
def test_a_bin_that_was_written_for_a_flash_says_how_it_is_written_for_the_port(container: Container) -> None:
    reversed_bits = bytes(int(f"{byte:08b}"[::-1], 2) for byte in convert(small(), container))
    with pytest.raises(NoSync, match=r"^the bits of each byte are reversed: write_cfgmem .* -disablebitswap$"):
        open_image(reversed_bits)


WHOLE, WORDS = small(), open_image(small()).offset


@pytest.mark.parametrize(
    ("data", "error", "said"),
    [
        (WHOLE[:15], Truncated, "header ends at byte 15, where field 'a' should be"),
        (WHOLE[:16], Truncated, "header: field 'a' says 55 bytes, the file ends 55 bytes before"),
        (WHOLE[:70], Truncated, "header: field 'a' says 55 bytes, the file ends 1 bytes before"),
        (WHOLE[:71], Truncated, "header ends at byte 71, where field 'b' should be"),
        (WHOLE[: WORDS - 1], Truncated, f"header ends at byte {WORDS - 1}, where field 'e' should be"),
        (WHOLE[:WORDS], Truncated, "header says 656 bytes of configuration, 0 are there"),
        (WHOLE[:-1], Truncated, "header says 656 bytes of configuration, 655 are there"),
        (WHOLE + bytes(4), BadContainer, "header says 656 bytes of configuration, 4 more follow"),
        (WHOLE[:13] + b"\xfa" + WHOLE[14:], BadContainer, "header: field 'a' expected at byte 13, found 0xfa"),
        (WHOLE[: WORDS - 5] + b"z" + WHOLE[WORDS - 4 :], BadContainer,
         f"header: field 'e' expected at byte {WORDS - 5}, found 0x7a"),
        (WHOLE.replace(b"xc7z020\0", b"xc7z020!"), BadContainer, "header: field 'b' at byte 71 does not end with NUL"),
        (WHOLE.replace(b"\0\x08xc7z020\0", b"\0\0"), BadContainer,
         "header: field 'b' at byte 71 does not end with NUL"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_bit_header_is_said_with_its_place(data: bytes, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=f"^\\.bit {said}$"):
        open_image(data)


@pytest.mark.parametrize("pattern", ["aa995566", "665599aa"])
def test_a_sync_word_is_looked_for_in_the_first_64_kib_and_where_words_begin(pattern: str) -> None:
    swapped, sync = pattern == "665599aa", bytes.fromhex(pattern)
    assert open_image(bytes(65532) + sync).swapped is swapped
    assert open_image(b"\xff" + sync * 2 + bytes(3) + sync[::-1] + sync).swapped is not swapped
    assert open_image(b"\xff" + sync + bytes(3) + sync + sync[::-1] + sync).swapped is swapped
    with pytest.raises(NoSync, match=r"^neither a \.bit header nor a boot image, .* in the first 65536 bytes$"):
        open_image(bytes(65536) + sync)
    for stream, length in ((bytes(65536) + sync, 65536), (bytes(8), 8)):
        with pytest.raises(
            NoSync, match=rf"^no sync word AA995566 in the first {length} bytes after the \.bit header$"
        ):
            open_image(pack_bit(HEADER, stream))


@pytest.mark.parametrize(
    ("fields", "user_id", "partial"),
    [
        ((), None, False),
        ((("userid", "c0ffee"), ("partial", "true")), 0xC0FFEE, True),
        ((("UserID", "0xC0FFEE"), ("PARTIAL", "FALSE")), 0xC0FFEE, False),
        ((("UserID", "0XFFFFFFFF"), ("PARTIAL", None)), None, False),
        ((("UserID", "123456789"),), None, False),
        ((("UserID", "1=1"), ("UserID", "1")), None, False),
        ((("UserID", "0xC0FFEE"), ("PARTIAL", "TRUE"), ("Version", "2018.3")), 0xC0FFEE, True),
        ((("PARTIAL", "TRUE"), ("UserID", "0xC0FFEE"), ("Version", "2025.2"), ("SW_CRC", "6b1f4a02")), 0xC0FFEE, True),
    ],
)
def test_a_header_says_which_static_design_and_whether_it_is_partial(
    fields: tuple[tuple[str, str | None], ...], user_id: int | None, partial: bool
) -> None:
    header = BitHeader("top", fields, "7z020clg400", "2024/01/01", "00:00:00")
    assert (header.user_id, header.partial) == (user_id, partial)
    for one in (header, replace(header, design="d" * 40000)):
        assert open_image(pack_bit(one, bytes.fromhex("aa995566"))).header == one


@pytest.mark.parametrize(
    ("data", "form", "told"),
    [
        (convert(WHOLE, Container.BIN_SWAPPED), Container.BIT,
         "a .bit needs a header (design, part, date, time), and a .bin has none: give one"),
        (WHOLE, Container.BOOTGEN, "boot images are read, not written: use bootgen with the .bit"),
        (pack_bit(HEADER, bytes.fromhex("ffffffff665599aa")), Container.BIN_STRAIGHT,
         "the words behind the .bit header are byte-swapped: convert a .bit from the original file"),
    ],
)  # fmt: skip
def test_what_cannot_be_converted_says_why(data: bytes, form: Container, told: str) -> None:
    with pytest.raises(BadContainer, match=f"^{re.escape(told)}$"):
        convert(data, form)


@given(data=st.data())
def test_every_truncation_of_a_bit_is_refused(data: st.DataObject) -> None:
    whole = small()
    cut = data.draw(st.integers(0, len(whole) - 1))
    with pytest.raises((Truncated, NoSync)):
        open_image(whole[:cut])


@given(data=st.data())
def test_every_truncation_of_a_bin_is_refused(data: st.DataObject) -> None:
    whole = convert(small(), Container.BIN_SWAPPED)
    cut = data.draw(st.integers(0, len(whole) - 16 * 4 - 1))  # what follows DESYNC may be missing
    with suppress(BitstreamError):
        assert inspect(whole[:cut]).problems


@given(data=st.binary(max_size=300), prefix=st.sampled_from([b"", small()[:20], small()[:110], boot_image(b"")]))
def test_any_bytes_are_opened_or_refused(data: bytes, prefix: bytes) -> None:
    with suppress(BitstreamError):
        assert isinstance(open_image(prefix + data), Image)
        inspect(prefix + data)


def test_words_by_which_a_bin_could_not_be_recognised_are_refused() -> None:
    inner = next(data for data in (small(design="d" * n) for n in range(1, 5)) if open_image(data).offset % 4 == 0)
    nested = pack_bit(HEADER, inner)  # a header written twice: without the first one it would be another .bit
    assert open_image(nested).container is Container.BIT
    with pytest.raises(BadContainer, match=r"begin .*bin-straight"):
        convert(nested, Container.BIN_STRAIGHT)
    assert len(to_dma_words(nested)) == len(inner)

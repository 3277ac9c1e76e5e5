# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re

import pytest
from bitstream_support import HERE, bit, frames, small

from cm.formats.bitstream import (
    Container,
    Expectation,
    FrameAddress,
    FrameRun,
    assemble,
    assemble_module,
    convert,
    default_footprint,
    footprint_of,
    inspect,
    refusals,
    verify,
)
from cm.formats.bitstream.errors import BitstreamError, Sha256Mismatch, WrongDevice, errors_by_code
from cm.schema.model import FrameRange

OWNED = (FrameRange(block_type=0, row=0, column_first=26, column_last=27),)


def codes(data: bytes, expect: Expectation) -> list[str]:
    return [item.code for item in refusals(inspect(data), expect)]


def written_to(address: FrameAddress, count: int = 1) -> bytes:
    return assemble("xc7z020", [FrameRun(address, frames(count))])


def test_matching_bitstreams_are_not_refused() -> None:
    report = inspect(small())
    expect = Expectation("xc7z020", 0x13727093, True, OWNED, sha256=report.sha256.upper())
    assert refusals(report, expect) == ()
    verify(report, expect)


def test_device_that_is_in_no_table_is_compared_by_its_part_name() -> None:
    unknown = bit(0x30018001, 0x04A11093, 0x30004000 | 93, *[0] * 93, 0x30008001, 13)
    data = unknown.replace(b"7z020clg400", b"xczu99eg-sf")
    assert codes(data, Expectation("xczu99eg")) == []
    assert codes(data, Expectation("xczu98eg")) == ["wrong_device"]
    nameless = bit(0x30004000 | 93, *[0] * 93, 0x30008001, 13)  # only its header says for what it is
    hint = ", whose IDCODE is not known (did you mean xc7z015?)"
    for expect, told in (
        (Expectation("xc7z010"), "built for xc7z020, meant for xc7z010"),
        (Expectation("xc7z01"), f"built for xc7z020, meant for xc7z01{hint}"),
        (Expectation("xc7z01", 5), "built for xc7z020, meant for xc7z01"),
        (Expectation(idcode=5), "cannot tell whether xc7z020 is IDCODE 00000005: give the device's IDCODE, or a .bit"),
    ):
        assert refusals(inspect(nameless), expect)[-1].message == told
    assert codes(small(part="xc9"), Expectation("xc7z020")) == []  # a name that says nothing contradicts nothing


@pytest.mark.parametrize(
    ("data", "expect", "wanted"),
    [
        (small(), Expectation(idcode=0x03722093), ["wrong_device"]),
        (small(partial=False), Expectation(partial=True), ["not_partial"]),
        (small(), Expectation(partial=False), ["not_full"]),
        (written_to(FrameAddress(0, 1, 26)), Expectation(footprint=OWNED), ["footprint_outside"]),
        (written_to(FrameAddress(1, 0, 2)), Expectation(footprint=OWNED), ["footprint_outside"]),
        (written_to(FrameAddress(0, 0, 25)), Expectation(footprint=OWNED), ["footprint_outside"]),
        (written_to(HERE, 73), Expectation(footprint=OWNED), []),
        (written_to(HERE, 500), Expectation(footprint=OWNED), ["footprint_outside"]),
    ],
    ids=["idcode", "full for a region", "partial for the device", "row", "block type", "column", "whole", "too long"],
)
def test_what_does_not_fit_its_purpose_is_refused(data: bytes, expect: Expectation, wanted: list[str]) -> None:
    assert codes(data, expect) == wanted


def on_ultrascale(address: FrameAddress, count: int) -> bytes:
    return assemble("xck26", [FrameRun(address, bytes(372 * count))])


@pytest.mark.parametrize(
    ("block_type", "fit", "learned"),
    [(0, 79, 77), (1, 259, 257), (2, 2000, 2000)],
    ids=["logic", "contents", "of no known kind"],
)
def test_where_columns_are_not_public_a_run_may_be_as_long_as_the_widest(
    block_type: int, fit: int, learned: int
) -> None:
    """`learned`: so many frames may be of one column: those of the widest, and one that pushes the last one out."""
    one = FrameRange(block_type, 0, 5, 5)
    here, ranges = FrameAddress(block_type, 0, 5), (one, FrameRange(block_type + 1, 0, 5, 9))
    assert footprint_of(inspect(on_ultrascale(here, 1))) == (one,)
    assert codes(on_ultrascale(here, fit), Expectation(footprint=ranges)) == []
    assert footprint_of(inspect(on_ultrascale(here, learned))) == (one,)
    if block_type < 2:
        wider = (FrameRange(block_type, 0, 5, 6),)
        assert codes(on_ultrascale(here, fit + 1), Expectation(footprint=ranges)) == ["footprint_outside"]
        assert codes(on_ultrascale(here, 2 * fit - 1), Expectation(footprint=wider)) == []
        assert codes(on_ultrascale(here, 2 * fit), Expectation(footprint=wider)) == ["footprint_outside"]
        assert footprint_of(inspect(on_ultrascale(here, learned + 1))) == wider


@pytest.mark.parametrize(("count", "more"), [(4, ""), (6, "; and 2 more")])
def test_the_first_four_of_the_frames_outside_are_named(count: int, more: str) -> None:
    data = assemble("xc7z020", [FrameRun(FrameAddress(0, 0, 30 + at), frames(1)) for at in range(count)])
    (found,) = refusals(inspect(data), Expectation(footprint=(*OWNED, FrameRange(1, 32, 2, 3))))
    named = "; ".join(f"1 frames from block type 0 row 0 column {30 + at}" for at in range(4))
    owned = "block type 0 row 0 columns 26-27, block type 1 row 32 columns 2-3"
    assert found.message == f"writes {named}{more}; the region owns {owned}"


@pytest.mark.parametrize(
    ("expect", "told"),
    [
        (Expectation("xc7z010"), "whether an unknown device is xc7z010"),
        (Expectation("xc7z010", idcode=1), "whether an unknown device is xc7z010"),
        (Expectation(idcode=0x03722093), "whether an unknown device is IDCODE 03722093"),
    ],
)
def test_a_bitstream_that_does_not_say_its_device_is_refused_with_what_would_help(
    expect: Expectation, told: str
) -> None:
    nameless = convert(bit(0x30004000 | 93, *[0] * 93, 0x30008001, 13), Container.BIN_SWAPPED)
    said = refusals(inspect(nameless), expect)[-1]
    assert said.message == f"cannot tell {told}: give the device's IDCODE, or a .bit"


HIDDEN = bit(0x30018001, 0x03727093, 0x30016004, 1, 2, 3, 4, 0x30034001, 4, 9, 9, 9, 9)  # encrypted
DISGUISED = convert(convert(small(partial=False), Container.BIN_SWAPPED), Container.BIT, inspect(small()).header)
REGION, WHOLE = (
    "a full bitstream{}: a region needs a partial one",
    "a partial bitstream{}: the whole device needs a full one",
)
SAYS_PARTIAL = " (its header says partial, but it sets WBSTAR and TIMER)"
SAYS_FULL = " (its header says full, but it does not set WBSTAR and TIMER)"


def said_full(data: bytes) -> bytes:
    return data.replace(b"PARTIAL=TRUE", b"PARTIAL=NONE")


@pytest.mark.parametrize(
    ("data", "partial", "encrypted", "told"),
    [
        (small(), True, False, None),
        (small(), False, False, WHOLE.format("")),
        (small(partial=False), True, False, REGION.format("")),
        (small(partial=False), False, False, None),
        (DISGUISED, True, False, REGION.format(SAYS_PARTIAL)),
        (DISGUISED, False, False, WHOLE.format(SAYS_PARTIAL)),
        (said_full(small()), True, False, REGION.format(SAYS_FULL)),
        (said_full(small()), False, False, WHOLE.format(SAYS_FULL)),
        (HIDDEN, True, True, None),
        (
            HIDDEN,
            True,
            False,
            "encrypted, so its frames cannot be checked: set allow_encrypted for the region to permit it",
        ),
        (HIDDEN, False, True, WHOLE.format("")),
        (said_full(HIDDEN), False, True, None),  # it hides whether it sets WBSTAR and TIMER
    ],
)
def test_header_and_packets_must_both_be_of_what_is_wanted(
    data: bytes, partial: bool, encrypted: bool, told: str | None
) -> None:
    found = refusals(inspect(data), Expectation(partial=partial, allow_encrypted=encrypted))
    assert [item.message for item in found] == ([] if told is None else [told])


def test_all_reasons_are_reported_and_the_first_names_the_error() -> None:
    named = "built for xc7z020 (IDCODE 03727093), meant for xc7z010 (IDCODE 03722093)"
    with pytest.raises(WrongDevice, match=f"^{re.escape(named)}. {WHOLE.format('')}$"):
        verify(inspect(small()), Expectation("xc7z010", partial=False))


def test_footprint_is_learned_from_a_good_module() -> None:
    learned = footprint_of(inspect(written_to(HERE, 73)))
    assert learned == OWNED  # two columns of 36 frames and one of padding
    assert codes(written_to(FrameAddress(0, 0, 27)), Expectation(footprint=learned)) == []
    assert codes(written_to(FrameAddress(0, 0, 28)), Expectation(footprint=learned)) == ["footprint_outside"]
    assert footprint_of(inspect(written_to(FrameAddress(5, 0, 9), 3))) == (FrameRange(5, 0, 9, 9),)  # of no known kind


def test_other_file_than_recorded_is_refused() -> None:
    report = inspect(small())
    with pytest.raises(Sha256Mismatch, match=f"^the file has sha256 {report.sha256}, recorded is {'a' * 64}$"):
        verify(report, Expectation(sha256="A" * 64))


def test_every_refusal_has_its_own_code() -> None:
    assert len(errors_by_code()) == 1 + len(BitstreamError.__subclasses__())


@pytest.mark.parametrize("device", ["xc7z020", "xck26"])
@pytest.mark.parametrize("size", [1, 20_000, 400_000])
def test_module_of_our_own_fits_its_footprint_and_no_other_regions(device: str, size: int) -> None:
    own, other = default_footprint(0, device, size), default_footprint(1, device, size)
    report = inspect(assemble_module("edge", device=device, size=size))
    assert refusals(report, Expectation(device, partial=True, footprint=own)) == ()
    assert [item.code for item in refusals(report, Expectation(footprint=other))] == ["footprint_outside"]
    assert report.length >= size

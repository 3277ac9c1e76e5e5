# SPDX-License-Identifier: Apache-2.0
"""The words that ask for frames, what is compared with what comes, and what is left out."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import pytest

from cm.device.native.bitstream import swap
from cm.formats.bitstream import FrameRun, assemble, assemble_module, inspect, open_image
from cm.formats.bitstream.errors import NoSync, WrongDevice
from cm.formats.bitstream.geometry import FrameAddress, encode_far, frame_order
from cm.formats.bitstream.idcodes import Device, Family, device_by_name
from cm.formats.bitstream.mask import Mask, mask_for
from cm.formats.bitstream.memory import dma_image, frames_of
from cm.formats.bitstream.readback import LoadedFrames, closing_words, repair_words, reply_words, request_words

LOGIC, TOP, CONTENTS = FrameAddress(0, 0, 2), FrameAddress(0, 32, 2), FrameAddress(1, 0, 0)
EVERYTHING = Mask(lambda _: {}, "none")


def known(name: str) -> Device:
    found = device_by_name(name)
    assert found is not None
    return found


ZYNQ = known("xc7z020")
FRAME = 4 * ZYNQ.family.frame_words


@pytest.fixture
def bitstream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two frames of logic and two of what is in block RAM; no database is installed."""
    monkeypatch.setenv("CM_XRAY_DATABASE", str(tmp_path / "none"))
    path = tmp_path / "plain.bit"
    runs = [FrameRun(at, b"\1\2\3\4" * (3 * FRAME // 4)) for at in (LOGIC, CONTENTS)]
    path.write_bytes(assemble(ZYNQ, runs))
    return path


def loaded(path: Path, device: Device = ZYNQ) -> LoadedFrames:
    return LoadedFrames(device, open_image(path), mask_for(path, device))


def words(data: bytes) -> str:
    """Big-endian words as they are written, without the NOPs, of which `~3` says how many there are."""
    told = " ".join(f"{word:08x}" for word in struct.unpack(f">{len(data) // 4}I", data))
    return re.sub(r"20000000(?: 20000000)*", lambda nops: f"~{len(nops[0].split())}", told)


def test_a_request_has_the_steps_of_the_configuration_guides() -> None:
    begin = "ffffffff 000000bb 11220044 ffffffff aa995566 ~1 30008001 00000007 ~6"  # RCRC; no SHUTDOWN: it runs on
    read = "30008001 00000004 ~1 30002001 00020480 28006000"
    assert words(request_words(Family.SERIES7, 0x00020480, 3)) == f"{begin} {read} 48{4 * 101:06x} ~34"
    assert words(request_words(Family.ULTRASCALE_PLUS, 0x00020480, 3)) == f"{begin} {read} 48{4 * 93 + 25:06x} ~66"
    assert words(closing_words()) == "~1 30008001 00000007 ~1 30008001 0000000d ~16"


def test_a_reply_begins_with_a_frame_of_padding_and_on_ultrascale_with_the_pipelines_words() -> None:
    assert reply_words(Family.SERIES7, 1) == 2 * 101
    assert reply_words(Family.ULTRASCALE_PLUS, 1) == 2 * 93 + 25


def test_a_repair_is_a_sound_bitstream_that_starts_nothing() -> None:
    stream = repair_words(ZYNQ, [(encode_far(LOGIC, ZYNQ.family), [bytes(FRAME)])])
    report = inspect(swap(stream))
    assert report.problems == ()
    assert (report.idcode, report.frames) == (ZYNQ.idcode, 2)
    begin = "ffffffff " * 8 + "000000bb 11220044 ffffffff ffffffff aa995566 ~1 30008001 00000007 ~2"
    frame = f"30018001 {ZYNQ.idcode:08x} 30002001 00000100 30008001 00000001 ~1 300040ca" + " 00000000" * 202
    end = "30000001 [0-9a-f]{8} ~2 30008001 0000000d ~16"  # no GRESTORE, no START
    assert re.fullmatch(f"{begin} {frame} {end}", words(stream))


def test_without_a_mask_what_is_in_block_ram_is_not_judged_and_the_answer_says_so(bitstream: Path) -> None:
    frames = loaded(bitstream)
    assert mask_for(bitstream, ZYNQ).source == "none"
    assert (frames.judged, len(frames.unjudged)) == (2, 2)
    assert {place.block_type for place in frames.unjudged} == {1}
    assert frames.why == (
        "the contents of block RAM are not compared, and nothing says which look-up tables are memories "
        "(no plain.msk, no database of Project X-Ray)"
    )


def test_a_mask_beside_the_bitstream_says_what_is_compared(bitstream: Path) -> None:
    mask = [FrameRun(at, b"\0\0\0\1" * (3 * FRAME // 4)) for at in (LOGIC, CONTENTS)]
    bitstream.with_suffix(".msk").write_bytes(assemble(ZYNQ, mask))
    frames = loaded(bitstream)
    assert mask_for(bitstream, ZYNQ).source == "msk"
    assert (frames.judged, frames.unjudged, frames.why) == (4, (), "plain.msk says what is not compared")
    part = frames.slices(2)[0]
    good = bytearray(part.reply_length - 2 * FRAME) + swap(b"\1\2\3\4" * (2 * FRAME // 4))
    alive, wrong = bytearray(good), bytearray(good)
    alive[-4] ^= 1  # bit 0 of the last word, as memory has it
    wrong[-4] ^= 2
    assert part.judge(alive) == ()
    (found,) = part.judge(wrong)
    assert (found.address, found.bits, found.volatile) == (FrameAddress(0, 0, 2, 1), (32 * 100 + 1,), True)
    assert frames.repair([found]) is None


@pytest.mark.parametrize(
    ("data", "error", "told"),
    [
        (b"", NoSync, "the file is empty"),
        (b"no bitstream", NoSync, "neither a .*"),
        (assemble("xc7z010", [FrameRun(LOGIC, bytes(2 * FRAME))]), WrongDevice, "a mask for xc7z010{}"),
        (bytes.fromhex("665599aa"), WrongDevice, "a mask for another device{}"),
    ],
    ids=["empty", "text", "another device", "of no device"],
)
def test_a_mask_that_is_none_of_this_bitstream_is_refused(
    bitstream: Path, data: bytes, error: type[Exception], told: str
) -> None:
    bitstream.with_suffix(".msk").write_bytes(data)
    with pytest.raises(error, match=rf"plain\.msk: {told.format(', beside a bitstream for xc7z020')}$"):
        loaded(bitstream)


def test_frames_of_a_device_whose_columns_are_not_public_cannot_be_judged(tmp_path: Path) -> None:
    path = tmp_path / "kria.bit"
    path.write_bytes(assemble("xck26", [FrameRun(LOGIC, bytes(2 * 93 * 4))]))
    for _ in ("without a mask", "with one"):
        frames = loaded(path, known("xck26"))
        assert (frames.judged, frames.slices(10), frames.unjudged) == (0, (), ())
        assert frames.why == "the frames of xck26's columns are not public"
        path.with_suffix(".msk").write_bytes(path.read_bytes())


def test_slices_hold_frames_that_follow_each_other_and_no_more_than_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "ours.bit"
    path.write_bytes(assemble_module("ours", size=60 * FRAME))
    frames = LoadedFrames(ZYNQ, open_image(path), EVERYTHING)
    sizes = [(part.reply_length // FRAME) - 1 for part in frames.slices(25)]
    assert frames.why == "no circuit is in these frames: they were assembled for the simulated board"
    assert LoadedFrames(ZYNQ, open_image(path), Mask(lambda _: {}, "msk", "stated")).why == "stated"
    nowhere = assemble(ZYNQ, [FrameRun(FrameAddress(2, 0, 0), bytes(2 * FRAME))])
    assert LoadedFrames(ZYNQ, open_image(nowhere), EVERYTHING).slices(25) == ()
    assert sum(sizes) == frames.judged == 60
    assert max(sizes) <= 25


def test_a_slice_asks_for_its_frames_and_a_repair_writes_each_that_is_wrong_anew(bitstream: Path) -> None:
    bitstream.write_bytes(assemble(ZYNQ, [FrameRun(at, b"\1\2\3\4" * (4 * FRAME // 4)) for at in (LOGIC, TOP)]))
    frames = LoadedFrames(ZYNQ, open_image(bitstream), EVERYTHING)
    slices = frames.slices(2)
    assert slices is frames.slices(2)
    begins = [encode_far(at, ZYNQ.family) for at in (LOGIC, LOGIC._replace(minor=2), TOP, TOP._replace(minor=2))]
    asked = [(begin, count) for begin, count in zip(begins, (2, 1, 2, 1), strict=True)]
    assert [part.request for part in slices] == [swap(request_words(ZYNQ.family, *one)) for one in asked]
    assert [part.reply_length for part in slices] == [4 * 101 * (count + 1) for _, count in asked]
    assert {part.closing for part in slices} == {swap(closing_words())}
    good = bytearray(3 * FRAME)
    good[FRAME:] = swap(b"\1\2\3\4" * (2 * FRAME // 4))
    assert slices[2].judge(good + b"more") == ()
    good[FRAME] ^= 0x80
    good[-1] ^= 0x80
    wrong = slices[2].judge(bytes(good))
    assert [(one.far, one.address, one.bits, one.volatile) for one in wrong] == [
        (begins[2], TOP, (7,), False),
        (begins[2] + 1, TOP._replace(minor=1), (32 * 100 + 31,), False),
    ]
    repair = frames.repair(wrong)
    assert repair == swap(repair_words(ZYNQ, [(one.far, [b"\1\2\3\4" * (FRAME // 4)]) for one in wrong]))
    assert frames_of(dma_image(repair), frame_order(ZYNQ.name, ZYNQ.family)).keys() == {one.far for one in wrong}


def test_a_run_goes_over_the_end_of_a_row_on_7_series_and_ends_there_on_ultrascale() -> None:
    for name, goes_on in (("xc7z020", True), ("xczu3eg", False)):
        device = known(name)
        order = frame_order(device.name, device.family)
        assert order is not None
        gap = order.order.index(None)
        run = dict(order.run(order.order[gap - 1] or 0))
        assert (0 in run, 1 in run, 3 in run) == (True, False, goes_on)

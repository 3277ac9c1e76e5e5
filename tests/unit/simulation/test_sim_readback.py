# SPDX-License-Identifier: Apache-2.0
"""What the simulated device holds, read back frame by frame through its port."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from cm.device import DeviceUnsupported, Icap, IcapErrors
from cm.device.native.bitstream import swap
from cm.formats.bitstream.assemble import FrameRun, SharedFrame, assemble
from cm.formats.bitstream.container import open_image, to_dma_words
from cm.formats.bitstream.geometry import FrameAddress
from cm.formats.bitstream.idcodes import Device, device_by_name
from cm.formats.bitstream.mask import Mask
from cm.formats.bitstream.readback import LoadedFrames, WrongFrame, closing_words, reply_words, request_words
from cm.simulation.software import Board, SimError

SCHEMA = """\
config:
  name: lab
  device: {device}
  regions:
    left: {{footprint: [{{block_type: 0, row: 0, columns: [4, 6]}}]}}
    right: {{footprint: [{{block_type: 0, row: 0, columns: [7, 9]}}]}}
  modules:
    ours: {{region: left, model: edge}}
    other: {{region: right}}
  modes: {{default: {{modules: [ours, other]}}}}
  mmio:
    - {{base_address: 0x1000, registers: {{plain: {{offset: 0x0, reset: 7}}}}}}
"""
NOTHING = Mask(lambda _: {}, "none")


@pytest.fixture(scope="module", params=["xc7z020", "xczu3eg"])
def started(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Board, Device]]:
    folder = tmp_path_factory.mktemp("lab")
    (folder / "lab.yaml").write_text(SCHEMA.format(device=request.param))
    known = device_by_name(request.param)
    assert known is not None
    with Board([folder], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        yield board, known


@pytest.fixture
def board(started: tuple[Board, Device]) -> Board:
    started[0].control.clear()
    started[0].control.reset()
    return started[0]


@pytest.fixture
def device(started: tuple[Board, Device]) -> Device:
    return started[1]


def bitstream(board: Board, name: str) -> Path:
    return board.root / f"lib/firmware/cm/lab/{name}.bit"


def load(board: Board, data: bytes) -> int:
    with Icap.open(root=board.root) as icap, icap.allocate(len(data)) as buffer:
        buffer.memoryview()[: len(data)] = data
        icap.load(buffer, len(data))
        return icap.wait(60).status


def read(board: Board, request: bytes, length: int, closing: bytes) -> bytes:
    """Words as for DMA."""
    with Icap.open(root=board.root) as icap, icap.allocate(len(request) + length + len(closing)) as buffer:
        middle, end = len(request), len(request) + length
        buffer.memoryview()[:middle] = request
        buffer.memoryview()[end : end + len(closing)] = closing
        icap.read(buffer, slice(0, middle), slice(middle, end), slice(end, end + len(closing)), cookie=3)
        done = icap.wait(60)
        assert (done.cookie, done.length, done.status) == (3, length, 0)
        return bytes(buffer.memoryview()[middle:end])


def check(board: Board, device: Device, data: bytes | Path, mask: Mask = NOTHING) -> list[WrongFrame]:
    """Every frame of a bitstream, compared."""
    frames = LoadedFrames(device, open_image(data), mask)
    assert frames.judged
    return [wrong for part in frames.slices(20) for wrong in part.judge(read(board, part.request, part.reply_length, part.closing))]  # fmt: skip # noqa: E501


def test_what_was_loaded_is_read_back(board, device):
    for name in ("ours", "other"):
        assert load(board, to_dma_words(bitstream(board, name))) == 0
    assert check(board, device, bitstream(board, "ours")) == check(board, device, bitstream(board, "other")) == []


def test_a_compressed_bitstream_leaves_its_shared_frames(board, device):
    words = device.family.frame_words
    there = tuple(FrameAddress(0, 0, 5, minor) for minor in (1, 3, 5))
    first = FrameRun(FrameAddress(0, 0, 4), bytes(range(4)) * words * 3)
    data = assemble(device, [first, SharedFrame(b"\1\2\3\4" * words, there)])
    assert load(board, to_dma_words(data)) == 0
    frames = LoadedFrames(device, open_image(data), NOTHING)
    assert frames.judged == 2 + 3
    assert check(board, device, data) == []


def test_each_upset_is_found_where_it_was_and_none_elsewhere(board, device):
    load(board, to_dma_words(bitstream(board, "ours")))
    load(board, to_dma_words(bitstream(board, "other")))
    hits = board.control.upset("left", 5)
    wrong = check(board, device, bitstream(board, "ours"))
    assert sorted((frame.far, bit) for frame in wrong for bit in frame.bits) == sorted(hits)
    assert check(board, device, bitstream(board, "other")) == []


def test_a_frame_that_is_written_anew_is_right_and_its_module_runs_on(board, device):
    data = bitstream(board, "ours")
    load(board, to_dma_words(data))
    board.control.upset("left", 3)
    frames = LoadedFrames(device, open_image(data), NOTHING)
    words = frames.repair(check(board, device, data))
    assert words is not None
    assert load(board, words) == 0
    assert check(board, device, data) == []
    assert board.control.state()["regions"]["left"]["module"] == "ours"


def test_other_frames_in_a_region_end_what_runs_there(board, device):
    load(board, to_dma_words(bitstream(board, "ours")))
    board.control.upset("left")
    words = device.family.frame_words
    assert load(board, to_dma_words(assemble(device, [FrameRun(FrameAddress(0, 0, 5), bytes(8 * words))]))) == 0
    assert board.control.state()["regions"]["left"]["module"] is None


def test_bits_under_a_mask_and_frames_that_nobody_can_judge_are_not_compared(board, device):
    data = bitstream(board, "ours")
    load(board, to_dma_words(data))
    ((far, bit),) = board.control.upset("left")
    assert check(board, device, data, Mask(lambda _: {far: 1 << bit}, "msk")) == []
    (wrong,) = check(board, device, data, Mask(lambda _: {far: 1 << (bit ^ 1)}, "msk"))
    assert (wrong.bits, wrong.volatile) == ((bit,), True)
    unjudged = LoadedFrames(device, open_image(data), Mask(lambda _: {far: None}, "msk"))
    assert len(unjudged.unjudged) == 1
    assert check(board, device, data, Mask(lambda _: {far: None}, "msk")) == []


def test_a_frame_whose_bits_the_fabric_changes_is_not_written_anew(board, device):
    data = bitstream(board, "ours")
    load(board, to_dma_words(data))
    ((far, bit),) = board.control.upset("left")
    mask = Mask(lambda _: {far: 1 << (bit ^ 1)}, "msk")
    assert LoadedFrames(device, open_image(data), mask).repair(check(board, device, data, mask)) is None


def test_a_named_bit_of_a_named_frame_is_turned_over_and_back(board, device):
    data = bitstream(board, "ours")
    load(board, to_dma_words(data))
    ((far, _),) = board.control.upset("left")
    assert board.control.upset("left", 1, far, 77) == [(far, 77)]
    board.control.upset("left", 1, far, 77)
    (wrong,) = check(board, device, data)
    assert 77 not in wrong.bits


@pytest.mark.parametrize(("region", "frame", "why"), [("middle", None, "no region"), ("left", None, "holds no conf")])
def test_what_holds_nothing_cannot_be_hit(board, region, frame, why):
    with pytest.raises(SimError, match=why):
        board.control.upset(region, 1, frame)


def test_a_port_without_a_way_back_says_so(board, device):
    board.control.inject("icap_write_only")
    with Icap.open(root=board.root) as icap, icap.allocate(8192) as buffer:
        assert not icap.info.readable
        with pytest.raises(DeviceUnsupported):
            icap.read(buffer, slice(0, 4), slice(4, 8), slice(8, 12))
        board.control.clear()
        assert icap.info.readable


def test_a_request_that_asks_for_nothing_times_out_and_leaves_the_port_usable(board, device):
    family = device.family
    closing = swap(closing_words())
    data = bitstream(board, "ours")
    with Icap.open(root=board.root) as icap, icap.allocate(4096) as buffer:
        buffer.memoryview()[2048 : 2048 + len(closing)] = closing
        icap.read(buffer, slice(0, 64), slice(64, 128), slice(2048, 2048 + len(closing)))
        done = icap.wait(60)
        assert (done.length, done.errors) == (0, IcapErrors.TIMEOUT)
    assert load(board, to_dma_words(data)) == 0
    assert check(board, device, data) == []
    assert 4 * reply_words(family, 1) > 8 * family.frame_words - 1
    assert swap(swap(request_words(family, 0, 1))) == request_words(family, 0, 1)

# SPDX-License-Identifier: Apache-2.0
"""The simulated board through its nodes: registers, interrupts, DMA, camera, loading."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator

import numpy as np
import pytest
from sim_support import Dma, Icap, Node, Uio, attribute

from cm.device.native.bitstream import swap
from cm.formats.bitstream.container import to_dma_words
from cm.simulation.software import Board, SimError
from cm.simulation.software.hardware import camera
from cm.simulation.software.hardware.models import Colorise, edge
from cm.simulation.software.transport import protocol as p

PIXELS = 480 * 640
STATIC, PRR0, PRR1 = "dev/uio0", "dev/uio1", "dev/uio2"
FIRMWARE = "lib/firmware/cm/camera"
IDENT, FOCUS, ZOOM, THRESHOLD, PALETTE, FRAMES, IRQ_STATUS = 0x1000, 0x1010, 0x1014, 0x1018, 0x101C, 0x1020, 0x1024


@pytest.fixture(scope="module")
def shared() -> Iterator[Board]:
    with Board(arguments=["--hold", "0", "--rate", "0"]) as started:
        yield started


@pytest.fixture
def board(shared: Board) -> Iterator[Board]:
    """The shipped camera example after power-up; at the end of the test nothing may be left behind."""
    shared.control.clear()
    shared.control.reset()
    yield shared
    state = shared.control.state()
    assert (state["connections"], state["buffers"], state["memory"]) == (1, 0, 0)


def words(board: Board, module: str) -> bytes:
    return to_dma_words(board.root / FIRMWARE / f"{module}.bit")


def load(board: Board, module: str) -> None:
    with Icap(board.root, "dev/cm_icap0") as icap:
        assert icap.load(words(board, module)) == (0, 0)


def capture(board: Board, length: int = PIXELS) -> np.ndarray:
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        handle, memory = channel.alloc(length)
        channel.submit(handle, length)
        completion = channel.done()
        assert completion[4] == 0
        return memory[: completion[1]].copy()


def photo() -> np.ndarray:
    return next(iter(camera.shipped_photos().values()))


def refusal(call, *arguments) -> int:
    with pytest.raises(OSError) as caught:
        call(*arguments)
    return caught.value.errno


class Loop:
    """The two channels of the loop, each with one buffer."""

    def __init__(self, board: Board, length: int = PIXELS) -> None:
        self.source, self.sink = Dma(board.root, "dev/cm_dma/to_pl"), Dma(board.root, "dev/cm_dma/from_pl")
        self.source_handle, self.source_memory = self.source.alloc(length)
        self.sink_handle, self.sink_memory = self.sink.alloc(length)

    def send(self, data: np.ndarray, room: int | None = None) -> tuple[int, ...]:
        self.source_memory[: data.size] = data.reshape(-1)
        self.sink.submit(self.sink_handle, room or data.size)
        self.source.submit(self.source_handle, data.size)
        assert self.source.done()[1:5:3] == (data.size, 0)
        return self.sink.done()

    def __enter__(self) -> Loop:
        return self

    def __exit__(self, *_: object) -> None:
        self.source.close()
        self.sink.close()


# --- registers


def test_sysfs_tells_name_address_and_size_of_each_window(board):
    def text(index, name):
        return (board.root / f"sys/class/uio/uio{index}" / name).read_text().strip()

    windows = [(text(i, "name"), text(i, "maps/map0/addr"), text(i, "maps/map0/size")) for i in range(3)]
    assert windows == [("static", "0x1000", "0x1000"), ("prr0", "0x2000", "0x2000"), ("prr1", "0x6000", "0x2000")]


def test_a_register_of_the_static_part_keeps_what_is_written_in_any_width(board):
    with Uio(board.root, STATIC) as uio:
        uio.write(0x14, 0x11223344)
        assert uio.read(0x14) == 0x11223344
        assert [uio.read(0x14 + at, 8) for at in range(4)] == [0x44, 0x33, 0x22, 0x11]
        uio.write(0x16, 0xABCD, 16)
        assert uio.read(0x10, 64) == 0xABCD3344 << 32


def test_a_read_only_register_ignores_writes(board):
    with Uio(board.root, STATIC) as uio:
        uio.write(0x10, 5)
        assert uio.read(0x10) == 0


@pytest.mark.parametrize(("offset", "width"), [(2, 32), (0x1000, 32), (0xFFC, 64), (0, 24), (1 << 40, 32)])
def test_an_access_that_is_misaligned_or_outside_is_refused(board, offset, width):
    with Uio(board.root, STATIC) as uio:
        assert refusal(uio.read, offset, width) == errno.EINVAL


def test_registers_of_an_empty_region_read_as_garbage_and_lose_writes(board):
    with Uio(board.root, PRR0) as uio:
        uio.write(FOCUS, 3)
        assert uio.read(FOCUS) == 0xDEADBEEF
        load(board, "default")
        assert uio.read(FOCUS) == 1


def test_the_identity_register_tells_the_loaded_module(board):
    with Uio(board.root, PRR0) as uio:
        load(board, "edge")
        assert uio.read(IDENT) == 0xCA3E0002
        load(board, "default")
        assert uio.read(IDENT) == 0xCA3E0001


def test_loading_a_module_resets_the_registers_of_its_region_only(board):
    with Uio(board.root, PRR0) as region, Uio(board.root, STATIC) as static:
        load(board, "edge")
        region.write(FOCUS, 4)
        static.write(0x14, 99)
        load(board, "default")
        assert region.read(FOCUS) == 1
        assert static.read(0x14) == 99


def test_a_decoupled_region_reads_as_ones_and_loses_writes(board):
    load(board, "edge")
    with Uio(board.root, PRR0) as region, Uio(board.root, STATIC) as static:
        static.write(0, 1)
        assert region.read(FOCUS) == 0xFFFFFFFF
        region.write(FOCUS, 7)
        static.write(0, 0)
        assert region.read(FOCUS) == 1


# --- interrupts


def test_an_interrupt_comes_once_and_is_masked_until_one_is_written(board):
    load(board, "default")
    with Uio(board.root, PRR0) as uio:
        uio.unmask()
        board.control.interrupt("frame_done")
        first = uio.interrupt()
        board.control.interrupt("frame_done")
        assert uio.quiet()
        uio.unmask()  # the status bit still holds the line up
        assert uio.interrupt() == first + 1


def test_an_acknowledged_interrupt_does_not_come_again(board):
    load(board, "default")
    with Uio(board.root, PRR0) as uio:
        uio.unmask()
        board.control.interrupt("frame_done")
        uio.interrupt()
        assert uio.read(IRQ_STATUS) == 1
        uio.write(IRQ_STATUS, 1)
        assert uio.read(IRQ_STATUS) == 0
        uio.unmask()
        assert uio.quiet()


def test_every_frame_of_the_camera_raises_frame_done_and_counts(board):
    load(board, "default")
    with Uio(board.root, PRR0) as uio, Uio(board.root, PRR1) as other:
        uio.unmask()
        other.unmask()
        capture(board)
        uio.interrupt()
        assert uio.read(FRAMES) == 1
        assert other.quiet()


def test_a_dropped_interrupt_does_not_come_and_the_next_does(board):
    load(board, "default")
    board.control.inject("drop_interrupt", "frame_done")
    with Uio(board.root, PRR0) as uio:
        uio.unmask()
        board.control.interrupt("frame_done")
        assert uio.quiet()
        board.control.interrupt("frame_done")
        uio.interrupt()


def test_a_stuck_register_loses_writes_until_cleared(board):
    board.control.inject("register_stuck", "scratch")
    with Uio(board.root, STATIC) as uio:
        uio.write(0x14, 5)
        assert uio.read(0x14) == 0
        board.control.clear("register_stuck")
        uio.write(0x14, 5)
        assert uio.read(0x14) == 5


# --- channels and buffers


def test_info_tells_direction_and_length_of_a_frame(board):
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        info = channel.call(p.DMA_IOC_INFO, p.DMA_INFO.pack(p.DMA_INFO.size, *[0] * 8, b""))[0]
    fields = p.DMA_INFO.unpack(info)
    assert fields[2] == p.S2MM
    assert fields[8] == PIXELS
    assert fields[9].rstrip(b"\0") == b"camera"


def test_a_buffer_is_whole_pages_and_cannot_shrink(board):
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        alloc = p.BUFFER_ALLOC.pack(p.BUFFER_ALLOC.size, 0, 5000, 0, -1, 0, 0, 0)
        reply, fds = channel.call(p.DMA_IOC_ALLOC, alloc)
        assert p.BUFFER_ALLOC.unpack(reply)[2] == os.fstat(fds[0]).st_size == 8192
        with pytest.raises(PermissionError):
            os.ftruncate(fds[0], 4096)
        os.close(fds[0])


def test_allocations_beyond_the_boards_memory_are_refused(board):
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        assert refusal(channel.alloc, 1 << 40) == errno.ENOMEM
        assert refusal(channel.alloc, 0) == errno.EINVAL


def test_an_imported_memfd_is_written_to_and_can_no_longer_shrink(board):
    load(board, "loopback")
    fd = os.memfd_create("mine", os.MFD_ALLOW_SEALING)
    os.ftruncate(fd, 4096)
    with Loop(board) as loop:
        handle, length = loop.sink.attach(fd)
        assert length == 4096
        loop.source_memory[:640] = 7
        loop.sink.submit(handle, 640, offset=1000)
        loop.source.submit(loop.source_handle, 640)
        assert loop.sink.done()[1] == 640
        assert os.pread(fd, 642, 999) == b"\0" + b"\7" * 640 + b"\0"
        assert fcntl.fcntl(fd, fcntl.F_GET_SEALS) & fcntl.F_SEAL_SHRINK
        os.close(fd)
        fd = os.memfd_create("mine", 0)  # cannot be sealed: it may shrink
        os.ftruncate(fd, 4096)
        assert refusal(loop.sink.attach, fd) == errno.EINVAL
    os.close(fd)


@pytest.mark.parametrize(
    ("length", "offset", "period", "expected"),
    [
        (0, 0, 0, errno.EINVAL),
        (4097, 0, 0, errno.EINVAL),
        (4096, 1, 0, errno.EINVAL),
        (1 << 27, 0, 0, errno.EMSGSIZE),
        (4096, 0, 1000, errno.EINVAL),
    ],
)
def test_a_transfer_outside_its_buffer_is_refused(board, length, offset, period, expected):
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        handle, _ = channel.alloc(4096)
        assert refusal(channel.submit, handle, length, offset, 0, period) == expected


def test_unknown_flags_and_unknown_requests_are_refused(board):
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        handle, _ = channel.alloc(4096)
        flagged = p.DMA_SUBMIT.pack(p.DMA_SUBMIT.size, 0x80, handle, 0, 0, 4096, 0, 0)
        assert refusal(channel.call, p.DMA_IOC_SUBMIT, flagged) == errno.EINVAL
        assert refusal(channel.call, 0x12345678, b"") == errno.ENOTTY
        assert refusal(channel.call, p.OP_REG_READ, b"x" * 24) == errno.ENOTTY


# --- the loop


def test_the_loop_runs_the_model_of_the_loaded_module(board):
    load(board, "loopback_edge")
    picture = photo()
    with Loop(board) as loop:
        loop.send(picture)
        assert np.array_equal(loop.sink_memory[:PIXELS].reshape(480, 640), edge(picture, {}))


def test_a_packet_waits_until_there_is_room_for_it(board):
    load(board, "loopback")
    with Loop(board) as loop:
        loop.source_memory[:100] = 3
        loop.source.submit(loop.source_handle, 100)
        assert loop.source.quiet()
        loop.sink.submit(loop.sink_handle, PIXELS)
        assert loop.sink.done()[1] == 100
        assert loop.source.done()[1] == 100


def test_a_packet_larger_than_the_buffer_is_an_error_with_what_fits(board):
    load(board, "loopback")
    with Loop(board) as loop:
        data = np.arange(640, dtype=np.int64).astype(np.uint8)
        completion = loop.send(data, room=100)
        assert completion[1:5:3] == (100, -errno.EIO)
        assert np.array_equal(loop.sink_memory[:101], [*data[:100], 0])


def test_a_frame_of_lines_is_gathered_and_scattered(board):
    load(board, "loopback")
    with Loop(board) as loop:
        loop.source_memory[:] = np.resize(np.arange(256, dtype=np.uint8), loop.source_memory.size)
        loop.sink_memory[:] = 255
        loop.sink.submit_video(loop.sink_handle, 3, 10, 16)
        loop.source.submit_video(loop.source_handle, 3, 10, 20)
        assert loop.sink.done()[1] == 30
        lines = [loop.sink_memory[16 * n : 16 * n + 16].tolist() for n in range(3)]
        assert lines == [[*range(20 * n, 20 * n + 10), *[255] * 6] for n in range(3)]


def test_an_empty_region_gives_garbage_of_the_same_length(board):
    with Loop(board) as loop:
        data = np.zeros(6400, np.uint8)
        assert loop.send(data)[1] == 6400
        assert len(np.unique(loop.sink_memory[:6400])) > 200


def test_nothing_flows_through_a_decoupled_region_until_it_is_recoupled(board):
    load(board, "loopback")
    with Loop(board) as loop, Uio(board.root, STATIC) as static:
        static.write(0, 2)
        loop.source_memory[:640] = 9
        loop.sink.submit(loop.sink_handle, 640)
        loop.source.submit(loop.source_handle, 640)
        assert loop.sink.quiet()
        static.write(0, 0)
        assert loop.sink.done()[1] == 640
        assert loop.sink_memory[0] == 9


def test_a_cyclic_transfer_fills_its_periods_and_says_what_was_lost(board):
    load(board, "loopback")
    with Loop(board) as loop:
        loop.sink.submit(loop.sink_handle, 4 * 64, period=64, cookie=8)
        for value in range(6):
            loop.source_memory[64 * value : 64 * value + 64] = value + 1
            loop.source.submit(loop.source_handle, 64, offset=64 * value)
        for _ in range(6):
            loop.source.done()
        got = [loop.sink.done() for _ in range(4)]
        assert [(c[0], c[1], c[3], c[5]) for c in got] == [(8, 64, n, 0) for n in range(4)]
        assert loop.sink_memory[: 4 * 64 : 64].tolist() == [5, 6, 3, 4]
        loop.source.submit(loop.source_handle, 64)
        late = loop.sink.done()
        assert (late[3], late[5]) == (6, p.COMPLETION_OVERRUN)


# --- faults


def test_a_short_packet_has_the_length_that_was_ordered(board):
    load(board, "default")
    board.control.inject("short_packet", "camera", value=1000)
    assert len(capture(board)) == 1000
    assert len(capture(board)) == PIXELS


def test_a_dma_error_fails_one_transfer(board):
    load(board, "loopback")
    board.control.inject("dma_error", "from_pl")
    with Loop(board) as loop:
        assert loop.send(np.ones(64, np.uint8))[4] == -errno.EIO
        assert loop.send(np.ones(64, np.uint8))[4] == 0


def test_a_channel_that_hangs_moves_nothing_and_can_be_cancelled(board):
    load(board, "default")
    board.control.inject("hang", "camera")
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        handle, _ = channel.alloc(PIXELS)
        channel.submit(handle, PIXELS)
        assert channel.quiet()
        channel.cancel()
        assert channel.done()[4] == -errno.ECANCELED
        board.control.clear("hang")
        channel.submit(handle, PIXELS)
        assert channel.done()[1] == PIXELS


def test_an_unknown_fault_is_refused_with_those_there_are(board):
    with pytest.raises(SimError, match="short_packet"):
        board.control.inject("meteor")
    with pytest.raises(SimError, match="no fault is called hangs; there are short_packet"):
        board.control.clear("hangs")


@pytest.mark.parametrize(
    ("name", "target", "why"),
    [
        ("hang", "camra", "no channel is called camra; there are camera, "),
        ("drop_interrupt", "frame", "no interrupt is called frame; there are .*frame_done"),
        ("register_stuck", "scratcj", "no register is called scratcj; there are .*scratch"),
        ("icap_stall", "4096", "icap_stall has no target, so '4096' cannot be one"),
    ],
)
def test_a_fault_of_what_the_board_does_not_have_is_refused_with_what_it_has(board, name, target, why):
    with pytest.raises(SimError, match=why):
        board.control.inject(name, target)
    assert board.control.state()["faults"] == []


def test_what_the_control_cannot_do_it_says_in_a_sentence(board):
    with pytest.raises(SimError, match="no camera is called to_pl; there are camera"):
        board.control.pause("to_pl")
    with pytest.raises(SimError, match=r"no interrupt is called meteor; there are .*frame_done"):
        board.control.interrupt("meteor")


# --- the camera


def test_the_camera_shows_the_photograph_through_the_default_module(board):
    load(board, "default")
    assert np.array_equal(capture(board).reshape(480, 640), photo())


def test_focus_and_zoom_change_the_picture_as_documented(board):
    load(board, "default")
    with Uio(board.root, PRR0) as uio:
        uio.write(FOCUS, 3)
        uio.write(ZOOM, 2)
        assert np.array_equal(capture(board).reshape(480, 640), camera.frame(photo(), focus=3, zoom=2))


def test_the_edge_module_obeys_its_threshold(board):
    load(board, "edge")
    with Uio(board.root, PRR0) as uio:
        uio.write(THRESHOLD, 100)
        assert np.array_equal(capture(board).reshape(480, 640), edge(photo(), {"threshold": 100}))


def test_the_colorise_module_gives_three_bytes_per_pixel(board):
    load(board, "colorise")
    with Uio(board.root, PRR0) as uio:
        uio.write(PALETTE, 2)
        picture = capture(board, 3 * PIXELS).reshape(480, 640, 3)
        assert np.array_equal(picture, Colorise()(photo(), {"palette": 2}))


def test_an_empty_region_gives_garbage_instead_of_the_picture(board):
    assert not np.array_equal(capture(board).reshape(480, 640), photo())


def test_a_paused_camera_gives_a_frame_for_each_step(board):
    load(board, "default")
    board.control.pause("camera")
    with Dma(board.root, "dev/cm_dma/camera") as channel:
        handle, _ = channel.alloc(PIXELS)
        for cookie in range(3):
            channel.submit(handle, PIXELS, cookie=cookie)
        assert channel.quiet()
        board.control.step("camera", 2)
        assert [channel.done()[0] for _ in range(2)] == [0, 1]
        assert channel.quiet()
        board.control.resume("camera")
        assert channel.done()[0] == 2


# --- loading


def test_a_bitstream_goes_to_the_region_that_its_frames_name(board):
    load(board, "loopback_edge")
    regions = board.control.state()["regions"]
    assert regions["prr0"]["module"] is None
    assert regions["prr1"]["module"] == "loopback_edge"


def damaged(data: bytes) -> bytes:
    """One bit of the frame data is wrong."""
    changed = bytearray(data)
    changed[len(data) // 2] ^= 1
    return bytes(changed)


def other_device(data: bytes) -> bytes:
    return data.replace(bytes.fromhex("93707203"), bytes.fromhex("93207203"))


@pytest.mark.parametrize(
    ("change", "status", "bit", "left"),
    [
        (damaged, -errno.EILSEQ, p.ERR_CRC, None),
        (other_device, -errno.ENODEV, p.ERR_ID, "default"),
        (lambda data: data[: len(data) // 8 * 4], -errno.ETIMEDOUT, p.ERR_TIMEOUT, None),
        (lambda data: bytes(4096), -errno.EIO, p.ERR_NOSYNC, "default"),
        (swap, -errno.EIO, p.ERR_NOSYNC, "default"),
    ],
    ids=["crc", "idcode", "truncated", "nosync", "in the order of a .bit"],
)
def test_a_bad_bitstream_fails_and_leaves_garbage_where_it_wrote(board, change, status, bit, left):
    load(board, "default")
    with Icap(board.root, "dev/cm_icap0") as icap:
        assert icap.load(change(words(board, "edge"))) == (status, bit)
        assert icap.status()[:2] == (p.STATE_ERROR, bit)
    assert board.control.state()["regions"]["prr0"]["module"] == left


@pytest.mark.parametrize(("fault", "status"), [("icap_crc", -errno.EILSEQ), ("icap_hang", -errno.ETIMEDOUT)])
def test_an_injected_fault_fails_one_load(board, fault, status):
    board.control.inject(fault)
    with Icap(board.root, "dev/cm_icap0") as icap:
        assert icap.load(words(board, "edge"))[0] == status
        assert icap.load(words(board, "edge"))[0] == 0


def test_a_port_that_stands_still_takes_the_words_when_it_goes_on(board):
    load(board, "default")
    board.control.inject("icap_stall", value=1000)
    with Icap(board.root, "dev/cm_icap0") as icap:
        icap.start(words(board, "edge"))
        assert icap.quiet(0.05)
        state, _, done, *_ = icap.status()
        assert (state, done) == (p.STATE_LOADING, 1000)
        assert board.control.state()["regions"]["prr0"]["module"] == "default"
        board.control.clear("icap_stall")
        assert icap.finished() == (0, 0)
    assert board.control.state()["regions"]["prr0"]["module"] == "edge"


# --- attributes


def test_the_control_attribute_refuses_invalid_commands(board):
    for order in (b"", b"{}", b'{"do": "dance"}', b"\xff"):
        with pytest.raises(OSError):
            attribute(board.root, "sim/control", order)


def test_malformed_requests_get_an_error_and_the_board_lives_on(board):
    with Node(board.root, STATIC) as node:
        for packet in (b"x", p.REQUEST.pack(1, 99), p.REQUEST.pack(1, 0), b"\xff" * 4000):
            node.sock.send(packet)
            with pytest.raises(OSError):
                node._reply()
        assert p.REG.unpack(node.call(p.OP_REG_READ, p.REG.pack(0, 32, 0, 0))[0])[3] == 0

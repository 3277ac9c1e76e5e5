# SPDX-License-Identifier: Apache-2.0
"""Errors, look-ups and lifetimes of cm.device, with nodes that refuse, answer wrongly or die."""

from __future__ import annotations

import errno
import gc
import os
import signal
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_node import (
    ATTR_READ,
    ATTR_WRITE,
    MKDIR,
    REG,
    REG_READ,
    REG_WRITE,
    RMDIR,
    FakeNode,
    Reply,
    attribute,
    uio_class,
)
from manager_process import until

import cm.device as device
from cm.device.errors import device_error
from cm.device.survey import State, survey
from cm.errors import Busy, CmError, InvalidRequest, Timeout

DMA_INFO, DMA_ALLOC, DMA_IMPORT, DMA_FREE, DMA_SUBMIT = 0xC048C500, 0xC028C501, 0xC018C502, 0x4010C503, 0x4030C504
DTBO = b"\xd0\x0d\xfe\xed and the rest"
OVERLAYS = "sys/kernel/config/device-tree/overlays"
FPGA = "sys/class/fpga_manager/fpga0"


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


class Memory:
    """A UIO node's handler: a register file."""

    def __init__(self) -> None:
        self.words: dict[int, int] = {}
        self.widths: list[int] = []

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        index, width, offset, value = REG.unpack(payload)
        self.widths.append(width)
        if op == REG_WRITE:
            self.words[offset] = value
        assert op in (REG_READ, REG_WRITE)
        return 0, REG.pack(index, width, offset, self.words.get(offset, 0)), []


class Channel:
    """A DMA node's handler: completes at once with three bytes less, frees once told to."""

    def __init__(self) -> None:
        self.freed: list[int] = []
        self.free_error = 0
        self.sequence = 0
        self.imported = 0

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        if op == DMA_INFO:
            return 0, struct.pack("=IIIIIIQII32s", 72, 0, 2, 1, 5, 4, 1 << 23, 8, 640, b"cam\0junk"), []
        if op == DMA_ALLOC:
            size, flags, length = struct.unpack_from("=IIQ", payload)
            fd = os.memfd_create("fake")
            os.ftruncate(fd, length)
            return 0, struct.pack("=IIQIiIIQ", size, flags, length, 3, -1, 1, 0, 0x1000), [fd]
        if op == DMA_IMPORT:
            self.imported = os.fstat(fds[0]).st_size
            return 0, struct.pack("=IIiIQ", 24, 0, -1, 4, self.imported), []
        if op == DMA_FREE:
            self.freed.append(struct.unpack("=IIII", payload)[2])
            return self.free_error, b"", []
        if op == DMA_SUBMIT:
            *_, length, _period, cookie = struct.unpack("=IIIIQQQQ", payload)
            events.send(struct.pack("=QQQQiI", cookie, length - 3, 9, self.sequence, 0, 0))
            self.sequence += 1
            return 0, b"", []
        return errno.ENOTTY, b"", []


@pytest.fixture
def uio(tmp_path: Path) -> Iterator[tuple[device.Uio, Memory, FakeNode]]:
    uio_class(tmp_path, 3, "regs", [(0x2000, 0x100), (0x8000_0000, 0x40)])
    memory = Memory()
    with FakeNode(tmp_path, "dev/uio3", memory) as node, device.Uio.open("regs", tmp_path) as opened:
        yield opened, memory, node


@pytest.fixture
def dma(tmp_path: Path) -> Iterator[tuple[device.AxiDma, Channel]]:
    channel = Channel()
    with FakeNode(tmp_path, "dev/cm_dma/cam", channel), device.AxiDma.open("cam", tmp_path) as opened:
        yield opened, channel


@pytest.mark.parametrize(
    ("number", "ours", "builtin"),
    [
        (errno.ENOENT, device.DeviceNotFound, FileNotFoundError),
        (errno.EACCES, device.DevicePermission, PermissionError),
        (errno.EBUSY, device.DeviceBusy, Busy),
        (errno.ETIMEDOUT, device.DeviceTimeout, TimeoutError),
        (errno.ETIMEDOUT, device.DeviceTimeout, Timeout),
        (errno.ENODEV, device.DeviceGone, OSError),
        (errno.ECONNRESET, device.DeviceGone, OSError),
        (errno.EBADF, device.DeviceClosed, OSError),
        (errno.EEXIST, device.DeviceExists, FileExistsError),
        (errno.EINVAL, device.DeviceInvalid, InvalidRequest),
        (errno.EINVAL, device.DeviceInvalid, ValueError),
        (errno.EOPNOTSUPP, device.DeviceUnsupported, OSError),
        (errno.EIO, device.DeviceError, CmError),
    ],
)
def test_an_errno_is_an_exception_of_ours_and_the_builtin(number: int, ours: type, builtin: type) -> None:
    error = device_error(number, "open", "/dev/x", "do this")
    assert isinstance(error, ours)
    assert isinstance(error, builtin)
    assert error.errno == number
    assert str(error).startswith("cannot open /dev/x: ")
    assert str(error).endswith("; do this")


def test_every_kind_of_error_has_a_code_of_its_own() -> None:
    kinds = device.DeviceError.__subclasses__()
    assert len({kind.code for kind in kinds}) == len(kinds)


def test_a_missing_device_names_those_there_are(tmp_path: Path) -> None:
    with FakeNode(tmp_path, "dev/cm_dma/cam", Channel()), pytest.raises(device.DeviceNotFound, match="there are: cam"):
        device.AxiDma.open("lidar", tmp_path)


def test_a_missing_uio_device_names_those_there_are(tmp_path: Path) -> None:
    uio_class(tmp_path, 3, "regs", [(0x2000, 0x100)])
    with pytest.raises(device.DeviceNotFound, match=r"uio3 \(regs\)"):
        device.Uio.open("other", tmp_path)


def test_an_address_without_a_window_names_the_windows(tmp_path: Path) -> None:
    uio_class(tmp_path, 3, "regs", [(0x2000, 0x100)])
    with pytest.raises(device.DeviceNotFound, match=r"0x2100\+0x1.*uio3 regs 0x2000\+0x100"):
        device.Uio.open(0x2100, tmp_path)


def test_a_refused_open_carries_the_errno(tmp_path: Path) -> None:
    with FakeNode(tmp_path, "dev/cm_dma/cam", Channel(), errno.EBUSY), pytest.raises(device.DeviceBusy) as caught:
        device.AxiDma.open("cam", tmp_path)
    assert caught.value.errno == errno.EBUSY
    assert caught.value.filename == str(tmp_path / "dev/cm_dma/cam")


def test_a_board_that_is_not_served_says_how_to_start_it(tmp_path: Path) -> None:
    FakeNode(tmp_path, "dev/cm_icap0", Channel()).close()
    with pytest.raises(device.DeviceGone, match=f"cm sim --root {tmp_path}"):
        device.Icap.open(root=tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_denied_device_names_the_group(tmp_path: Path) -> None:
    with FakeNode(tmp_path, "dev/cm_icap0", Channel()):
        (tmp_path / "dev/cm_icap0").chmod(0o000)
        with pytest.raises(device.DevicePermission, match="udev rule"):
            device.Icap.open(root=tmp_path)


@pytest.mark.parametrize("name", ["../uio0", "a/b", "", "x" * 60, "nul\0"])
def test_a_channel_name_that_is_a_path_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(device.DeviceError):
        device.AxiDma.open(name, tmp_path)


def test_the_root_comes_from_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_ROOT", str(tmp_path))
    uio_class(tmp_path, 7, "regs", [(0x2000, 0x100)])
    assert [info.node for info in device.list_uio()] == ["uio7"]
    monkeypatch.setenv("CM_ROOT", "")
    assert device.Root.of(None).path == "/"


def test_uio_devices_are_listed_by_number_with_their_maps(tmp_path: Path) -> None:
    uio_class(tmp_path, 10, "b", [])
    uio_class(tmp_path, 2, "a", [(0x2000, 0x100), (0x9000, 0x10)])
    first, second = device.list_uio(tmp_path)
    assert (first.number, second.number) == (2, 10)
    assert first.maps[1] == device.UioMap("window1", 0x9000, 0x10, 0)
    assert device.find_uio(0x900C, 4, tmp_path) == (first, 1)


def test_more_uio_devices_than_fit_at_first_are_all_listed(tmp_path: Path) -> None:
    for number in range(70):
        uio_class(tmp_path, number, "a", [])
    assert [info.number for info in device.list_uio(tmp_path)] == list(range(70))


@pytest.mark.parametrize("name", ["regs", "uio3", 0x2010, 0x8000_003F])
def test_a_uio_device_opens_by_name_node_and_address(tmp_path: Path, name: str | int) -> None:
    uio_class(tmp_path, 3, "regs", [(0x2000, 0x100), (0x8000_0000, 0x40)])
    with FakeNode(tmp_path, "dev/uio3", Memory()), device.Uio.open(name, tmp_path) as opened:
        assert (opened.name, len(opened.maps)) == ("regs", 2)


@pytest.mark.parametrize("width", [8, 16, 32, 64])
def test_a_register_access_reaches_the_bus_as_one_of_its_width(
    uio: tuple[device.Uio, Memory, FakeNode], width: int
) -> None:
    regs, memory, _ = uio
    value = (1 << width) - 2
    regs.write(0x10, value, width, map=1)
    assert regs.read(0x10, width, map=1) == value
    assert memory.widths == [width, width]


@pytest.mark.parametrize(
    ("offset", "width", "index", "value"),
    [
        (0x100, 32, 0, 0),
        (2, 32, 0, 0),
        (0, 24, 0, 0),
        (0, 32, 2, 0),
        (-4, 32, 0, 0),
        (0, 32, 0, 1 << 32),
        (0, 8, 0, -1),
    ],
)
def test_an_access_that_does_not_fit_is_refused_before_the_bus(
    uio: tuple[device.Uio, Memory, FakeNode], offset: int, width: int, index: int, value: int
) -> None:
    regs, memory, _ = uio
    with pytest.raises(device.DeviceInvalid, match="map 0: 0x100 bytes, map 1: 0x40 bytes"):
        regs.write(offset, value, width, index)
    assert memory.widths == []


def test_a_wait_without_interrupt_times_out(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, _ = uio
    assert regs.take() is None
    with pytest.raises(device.DeviceTimeout):
        regs.wait(0.001)
    with pytest.raises(TimeoutError):
        regs.wait(-1)


def test_enabling_the_interrupt_writes_one(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, node = uio
    regs.enable_interrupt()
    regs.close()  # returns when the node has seen the end of both sockets
    node.close()
    assert node.written == [b"\1\0\0\0"]


@pytest.mark.parametrize("number", [errno.EIO, errno.EINVAL])  # of a read, of a write
def test_an_interrupt_of_a_device_whose_driver_was_unbound_is_of_one_that_has_gone(
    uio: tuple[device.Uio, Memory, FakeNode], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    opened, _, _ = uio
    (tmp_path / "sys/class/uio/uio3").rename(tmp_path / "sys/class/uio/gone")

    def dead(*_: object) -> None:
        raise OSError(number, "from the kernel")

    for name in ("take", "enable_interrupt", "wait_interrupt"):
        monkeypatch.setattr(f"cm.device.native.uio.{name}", dead)
    for call in (opened.take, opened.enable_interrupt, lambda: opened.wait(0)):
        with pytest.raises(device.DeviceGone, match="its driver was unbound"):
            call()


def test_use_after_close_is_its_own_error(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, _ = uio
    regs.close()
    regs.close()
    for use in (regs.fileno, regs.take, regs.enable_interrupt, lambda: regs.read(0), lambda: regs.wait(1)):
        with pytest.raises(device.DeviceClosed):
            use()


def test_closing_ends_the_wait_of_another_thread(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, _ = uio
    caught: list[BaseException] = []

    def wait() -> None:
        try:
            regs.wait()
        except device.DeviceError as error:
            caught.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    regs.close()
    thread.join(60)
    assert [type(error) for error in caught] == [device.DeviceClosed]


def test_a_wait_runs_signal_handlers_and_goes_on(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, _ = uio
    seen: list[int] = []
    before = signal.signal(signal.SIGALRM, lambda number, frame: seen.append(number))
    signal.setitimer(signal.ITIMER_REAL, 0.01)
    try:
        with pytest.raises(device.DeviceTimeout):
            regs.wait(0.2)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert seen == [signal.SIGALRM]


def test_after_a_board_dies_every_call_raises_gone(uio: tuple[device.Uio, Memory, FakeNode]) -> None:
    regs, _, node = uio
    node.close()
    for use in (lambda: regs.read(0), regs.take, lambda: regs.wait(5), regs.enable_interrupt):
        with pytest.raises(device.DeviceGone):
            use()


def test_a_channel_describes_itself(dma: tuple[device.AxiDma, Channel]) -> None:
    info = dma[0].info
    assert (info.name, info.direction, info.type) == ("cam", device.Direction.S2MM, device.DmaType.AXIDMA)
    assert info.caps == device.DmaCaps.CYCLIC | device.DmaCaps.RESIDUE
    assert (info.queue_depth, info.max_length, info.alignment, info.frame_length) == (4, 1 << 23, 8, 640)


def test_a_completion_has_the_length_that_moved(dma: tuple[device.AxiDma, Channel]) -> None:
    with dma[0].allocate(64) as buffer:
        dma[0].submit(buffer, cookie=1 << 63)
        assert dma[0].wait(60) == device.Completion(1 << 63, 61, 9, 0, 0, False)
        assert dma[0].completions() == []


def test_memory_outlives_buffer_and_channel(dma: tuple[device.AxiDma, Channel]) -> None:
    buffer = dma[0].allocate(4096)
    array = buffer.array()
    array[:] = 7
    fd = os.dup(buffer.fd)
    buffer.close()
    dma[0].close()
    gc.collect()
    assert os.pread(fd, 4096, 0) == bytes([7]) * 4096
    array[0] = 9
    assert os.pread(fd, 1, 0) == b"\x09"
    os.close(fd)


def test_a_buffer_that_is_unmapped_is_mapped_again_where_it_is_used(dma: tuple[device.AxiDma, Channel]) -> None:
    with dma[0].allocate(4096) as buffer:
        mapped = lambda: Path("/proc/self/maps").read_text().count("memfd:")  # noqa: E731
        before, view = mapped(), buffer.memoryview()
        view[0] = 7
        buffer.unmap()
        assert (mapped() - before, view[0]) == (1, 7)  # the view's own
        del view
        assert (mapped() - before, buffer.memoryview()[0]) == (0, 7)


def test_a_view_for_reading_cannot_be_written(dma: tuple[device.AxiDma, Channel]) -> None:
    with dma[0].allocate(64) as buffer:
        view = buffer.array(8, 16, writable=False)
        buffer.array()[8] = 5
        assert (view[0], view.size, view.dtype) == (5, 16, np.uint8)
        with pytest.raises(ValueError, match="read-only"):
            view[0] = 1


@pytest.mark.parametrize(("offset", "length"), [(65, None), (0, 65), (-1, 4), (60, 5), (0, -1)])
def test_a_view_outside_of_the_buffer_is_refused(
    dma: tuple[device.AxiDma, Channel], offset: int, length: int | None
) -> None:
    with dma[0].allocate(64) as buffer, pytest.raises(device.DeviceInvalid, match="64 bytes"):
        buffer.array(offset, length)


def test_a_buffer_in_flight_stays_open(dma: tuple[device.AxiDma, Channel]) -> None:
    channel = dma[1]
    buffer = dma[0].allocate(64)
    channel.free_error = errno.EBUSY
    with pytest.raises(device.DeviceBusy, match="cancel"):
        buffer.close()
    assert buffer.fd >= 0
    channel.free_error = 0
    buffer.close()
    buffer.close()
    assert (channel.freed, buffer.fd) == ([3, 3], -1)


def test_a_buffer_closes_after_its_channel(dma: tuple[device.AxiDma, Channel]) -> None:
    buffer = dma[0].allocate(64)
    dma[0].close()
    buffer.close()
    with pytest.raises(device.DeviceClosed):
        buffer.sync_begin(write=False)


def test_an_imported_buffer_leaves_the_descriptor_to_its_owner(dma: tuple[device.AxiDma, Channel]) -> None:
    fd = os.memfd_create("ours")
    os.ftruncate(fd, 4096)
    with dma[0].import_buffer(fd, 4096) as buffer:
        buffer.array()[0] = 1
        assert (buffer.length, buffer.handle, buffer.fd == fd) == (4096, 4, False)
        buffer.sync_begin(write=True)  # nothing to do on a memfd, and no error
        buffer.sync_end(write=True)
    assert os.pread(fd, 1, 0) == b"\x01"
    with pytest.raises(device.DeviceInvalid):
        dma[0].import_buffer(fd, 4097)
    os.close(fd)
    assert dma[1].freed == [4, 4]


@pytest.mark.parametrize("argument", [-1, 1 << 64])
def test_a_number_that_the_interface_cannot_carry_is_refused(dma: tuple[device.AxiDma, Channel], argument: int) -> None:
    with pytest.raises(device.DeviceInvalid):
        dma[0].allocate(argument)
    with dma[0].allocate(64) as buffer, pytest.raises(device.DeviceInvalid):
        dma[0].submit(buffer, cookie=argument)


def test_what_a_driver_does_not_know_is_unsupported(dma: tuple[device.AxiDma, Channel]) -> None:
    with pytest.raises(device.DeviceUnsupported, match="cam"):
        dma[0].cancel()


def test_devices_leak_no_descriptor(tmp_path: Path) -> None:
    with FakeNode(tmp_path, "dev/cm_dma/cam", Channel()):
        with device.AxiDma.open("cam", tmp_path) as warm, warm.allocate(64) as buffer:
            buffer.array()
        before = open_descriptors()
        for _ in range(20):
            with device.AxiDma.open("cam", tmp_path) as opened, opened.allocate(64) as buffer:
                buffer.array()
        del opened, buffer  # a closed object keeps the event that wakes its waiters for as long as it exists
        gc.collect()
        until(lambda: open_descriptors() <= before)  # the fake ends its connections in threads of its own


class OverlayTree:
    """The overlay folder's node: makes folders as configfs would, applying nothing."""

    def __init__(self, root: Path, word: str) -> None:
        self.folder = root / OVERLAYS
        self.word = word

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        path = self.folder / payload.decode()
        if op == MKDIR:
            if path.exists():
                return errno.EEXIST, b"", []
            path.mkdir()
            (path / "status").write_text(f"{self.word}\n")
            (path / "dtbo").write_bytes(b"")
        if op == RMDIR:
            for entry in path.iterdir():
                entry.unlink()
            path.rmdir()
        return 0, b"", []


def test_an_overlay_is_applied_and_removed(tmp_path: Path) -> None:
    with FakeNode(tmp_path, f"{OVERLAYS}/.node", OverlayTree(tmp_path, "applied")):
        overlays = device.Overlays(tmp_path)
        overlays.apply("camera", DTBO)
        assert (tmp_path / OVERLAYS / "camera/dtbo").read_bytes() == DTBO
        assert (overlays.list(), overlays.status("camera")) == (["camera"], "applied")
        with pytest.raises(device.DeviceExists):
            overlays.apply("camera", DTBO)
        overlays.remove("camera")
        assert overlays.list() == []


def test_an_overlay_that_the_kernel_refuses_is_removed_again(tmp_path: Path) -> None:
    with FakeNode(tmp_path, f"{OVERLAYS}/.node", OverlayTree(tmp_path, "unapplied")):
        overlays = device.Overlays(tmp_path)
        with pytest.raises(device.DeviceError, match="status says 'unapplied'"):
            overlays.apply("camera", DTBO)
        assert overlays.list() == []


class Kernel(OverlayTree):
    """Makes a device for the overlay, which no driver takes, as another has its interrupt."""

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        bus = self.folder.parents[3] / "bus/platform"
        if op == MKDIR:
            for name in ("40000000.fabric", "40000000.cm-control"):
                node = bus / "devices" / name / "of_node"
                node.mkdir(parents=True, exist_ok=True)
                (node / "compatible").write_text("fpga-cm,window\0fpga-cm,uio\0generic-uio\0")
                (node / "interrupts").write_bytes(bytes([0, 0, 0, 0, 0, 0, 0, 29, 0, 0, 0, 4]))
            (bus / "drivers/uio_pdrv_genirq").mkdir(parents=True)
            (bus / "devices/40000000.fabric/driver").symlink_to("../../drivers/uio_pdrv_genirq")
        return super().__call__(op, payload, fds, events)


def test_an_applied_overlay_whose_device_got_no_driver_fails_and_says_who_holds_what(tmp_path: Path) -> None:
    with FakeNode(tmp_path, f"{OVERLAYS}/.node", Kernel(tmp_path, "applied")):
        overlays = device.Overlays(tmp_path)
        with pytest.raises(device.DeviceError) as refused:
            overlays.apply("loop_static", DTBO)
        assert overlays.list() == []
    said = str(refused.value)
    assert "overlay loop_static was applied, but 40000000.cm-control (fpga-cm,window) got no driver" in said
    assert "uio_pdrv_genirq did not take it, as 40000000.fabric (uio_pdrv_genirq) has its interrupt" in said
    assert "echo 40000000.fabric >/sys/bus/platform/drivers/uio_pdrv_genirq/unbind" in said


class BuiltInUio(OverlayTree):
    """A kernel whose own uio_pdrv_genirq takes the overlay's window; cm_window is loaded."""

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        bus = self.folder.parents[3] / "bus/platform"
        if op == MKDIR:
            node = bus / "devices/40010000.filter/of_node"
            node.mkdir(parents=True)
            (node / "compatible").write_text("fpga-cm,window\0fpga-cm,uio\0generic-uio\0")
            for driver in ("uio_pdrv_genirq", "cm_window"):
                (bus / "drivers" / driver).mkdir(parents=True)
            for file in ("drivers/uio_pdrv_genirq/unbind", "drivers_probe", "devices/40010000.filter/driver_override"):
                (bus / file).touch()
            (bus / "devices/40010000.filter/driver").symlink_to("../../drivers/uio_pdrv_genirq")
        return super().__call__(op, payload, fds, events)


def test_a_window_that_the_built_in_uio_took_is_given_to_the_module_that_lends_it(tmp_path: Path) -> None:
    bus = tmp_path / "sys/bus/platform"
    with FakeNode(tmp_path, f"{OVERLAYS}/.node", BuiltInUio(tmp_path, "applied")):
        device.Overlays(tmp_path).apply("camera", DTBO)
    assert (bus / "devices/40010000.filter/driver_override").read_text() == "cm_window\n"
    assert (bus / "drivers/uio_pdrv_genirq/unbind").read_text() == "40010000.filter"
    assert (bus / "drivers_probe").read_text() == "40010000.filter"


class Dtbocfg(OverlayTree):
    """The tree of the dtbocfg module: numbers for words, and nothing is applied before a 1 is written."""

    def __init__(self, root: Path, accepts: bool) -> None:
        super().__init__(root, "0")
        self.accepts = accepts
        self.statuses: list[FakeNode] = []

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        error, *rest = super().__call__(op, payload, fds, events)
        if op == MKDIR:
            path = f"{OVERLAYS}/{payload.decode()}/status"
            (self.folder.parents[4] / path).unlink()
            self.statuses.append(FakeNode(self.folder.parents[4], path, self._status))
        return error, rest[0], rest[1]

    def _status(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        if op == ATTR_WRITE and self.accepts:
            self.word = payload.decode()
        return 0, b"" if op == ATTR_WRITE else f"{self.word}\n".encode(), []


@pytest.mark.parametrize("accepts", [True, False])
def test_an_overlay_is_switched_on_where_the_kernel_wants_that(tmp_path: Path, accepts: bool) -> None:
    tree = Dtbocfg(tmp_path, accepts)
    with FakeNode(tmp_path, f"{OVERLAYS}/.node", tree):
        overlays = device.Overlays(tmp_path)
        if accepts:
            overlays.apply("camera", DTBO)
            assert overlays.status("camera") == "applied"
        else:
            with pytest.raises(device.DeviceError, match="'unapplied'"):
                overlays.apply("camera", DTBO)
            assert overlays.list() == []
    for node in tree.statuses:
        node.close()


def test_a_forgotten_buffer_is_given_back(dma: tuple[device.AxiDma, Channel]) -> None:
    before = open_descriptors()
    array = dma[0].allocate(64).array()
    gc.collect()
    assert dma[1].freed == [3]
    assert open_descriptors() == before
    array[:] = 1


@pytest.mark.parametrize("name", ["", "../a", ".hidden", "a/b", "-a", "a b"])
def test_an_overlay_name_that_is_a_path_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(device.DeviceInvalid):
        device.Overlays(tmp_path).apply(name, DTBO)


def test_what_is_not_an_overlay_is_refused_before_anything_is_created(tmp_path: Path) -> None:
    (tmp_path / OVERLAYS).mkdir(parents=True)
    with pytest.raises(device.DeviceInvalid, match="dtc"):
        device.Overlays(tmp_path).apply("camera", b"/dts-v1/;")
    assert device.Overlays(tmp_path).list() == []


def test_without_the_overlay_interface_it_says_so(tmp_path: Path) -> None:
    overlays = device.Overlays(tmp_path)
    assert (overlays.available(), overlays.list()) == (False, [])
    with pytest.raises(device.DeviceUnsupported, match="OF_CONFIGFS"):
        overlays.apply("camera", DTBO)


class Firmware:
    """The ``firmware`` attribute: loads, or fails as the kernel does."""

    def __init__(self, root: Path, state: str, error: int = 0) -> None:
        self.root, self.state, self.error = root, state, error
        self.names: list[bytes] = []

    def __call__(self, op: int, payload: bytes, fds: list[int], events: socket.socket) -> Reply:
        assert op in (ATTR_WRITE, ATTR_READ)
        self.names.append(payload)
        (self.root / FPGA / "state").write_text(f"{self.state}\n")
        return self.error, b"", []


@pytest.fixture
def fpga(tmp_path: Path) -> Path:
    for name, text in (("name", "Xilinx Zynq FPGA Manager\n"), ("state", "unknown\n"), ("status", "")):
        attribute(tmp_path, f"{FPGA}/{name}", text)
    return tmp_path


def test_mainline_cannot_load_through_sysfs(fpga: Path) -> None:
    manager = device.FpgaManager(0, fpga)
    assert (manager.name, manager.state, manager.status) == ("Xilinx Zynq FPGA Manager", "unknown", "")
    with pytest.raises(device.DeviceUnsupported, match="linux-xlnx"):
        manager.load("camera/edge.bin")


def test_a_load_writes_flags_then_the_name(fpga: Path) -> None:
    attribute(fpga, f"{FPGA}/flags", "0")
    firmware = Firmware(fpga, "operating")
    with FakeNode(fpga, f"{FPGA}/firmware", firmware):
        device.FpgaManager(0, fpga).load("camera/edge.bin", partial=True, encrypted=True)
    assert firmware.names == [b"camera/edge.bin"]
    assert (fpga / FPGA / "flags").read_text() == "5"


@pytest.mark.parametrize("error", [0, errno.EIO])
def test_a_load_that_failed_carries_the_kernels_words(fpga: Path, error: int) -> None:
    attribute(fpga, f"{FPGA}/flags", "0")
    with (
        FakeNode(fpga, f"{FPGA}/firmware", Firmware(fpga, "write error", error)),
        pytest.raises(device.DeviceError, match=r"edge\.bin.*state 'write error'"),
    ):
        device.FpgaManager(0, fpga).load("edge.bin")


@pytest.mark.parametrize("name", ["", "/etc/passwd", "../x", "a/../../x", "a\nb", "x" * 300])
def test_a_firmware_name_outside_of_the_folder_is_refused(fpga: Path, name: str) -> None:
    with pytest.raises(device.DeviceInvalid):
        device.FpgaManager(0, fpga).load(name)


def test_a_survey_of_an_empty_root_advises_for_each_kind(tmp_path: Path) -> None:
    found = survey(tmp_path)
    assert {finding.kind for finding in found.findings} == {"uio", "dma", "icap", "overlays", "fpga_manager"}
    assert all(finding.state is State.MISSING and finding.advice for finding in found.findings)
    assert not found.usable


def test_a_survey_finds_what_is_there(fpga: Path) -> None:
    uio_class(fpga, 3, "regs", [(0x2000, 0x100)])
    uio_class(fpga, 4, "unserved", [])
    attribute(fpga, "proc/modules", "cm_dma 16384 0 - Live 0x0\n")
    with FakeNode(fpga, "dev/uio3", Memory()), FakeNode(fpga, "dev/cm_dma/cam", Channel()):
        found = survey(fpga)
    states = {(finding.kind, finding.name): finding.state for finding in found.findings}
    assert states["uio", "regs"] is State.OK
    assert states["uio", "unserved"] is State.MISSING
    assert states["dma", "cam"] is State.OK
    assert states["fpga_manager", "fpga0"] is State.OK
    assert (states["module", "cm_dma"], states["module", "cm_icap"]) == (State.OK, State.MISSING)
    assert found.usable

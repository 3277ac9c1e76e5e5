# SPDX-License-Identifier: Apache-2.0
"""Overlays and the fpga_manager of the simulated board, and the device-tree blobs it reads."""

from __future__ import annotations

import errno
from collections.abc import Iterator

import pytest
from sim_support import Node, Uio, attribute

from cm.device import DeviceError, Overlays
from cm.formats import fdt
from cm.formats.bitstream.assemble import FrameRun, assemble
from cm.formats.bitstream.container import to_dma_words
from cm.formats.bitstream.geometry import FrameAddress
from cm.simulation.software import Board
from cm.simulation.software.transport import protocol as p

OVERLAYS = "sys/kernel/config/device-tree/overlays"
MANAGER = "sys/class/fpga_manager/fpga0"
FIRMWARE = "lib/firmware/cm/camera"


@pytest.fixture(scope="module")
def board() -> Iterator[Board]:
    with Board(arguments=["--hold", "0", "--rate", "0", "--pcap-rate", "0"]) as started:
        folder = started.root / FIRMWARE
        for name in ("edge", "default"):
            (folder / f"{name}.bin").write_bytes(to_dma_words(folder / f"{name}.bit"))
        (folder / "wrong.bin").write_bytes((folder / "edge.bit").read_bytes())
        yield started


def refusal(call, *arguments) -> int:
    with pytest.raises(OSError) as caught:
        call(*arguments)
    return caught.value.errno


def folder(board: Board, op: int, name: str) -> None:
    with Node(board.root, f"{OVERLAYS}/.node") as node:
        node.call(op, name.encode())


@pytest.fixture
def overlay(board: Board) -> Iterator[str]:
    folder(board, p.OP_MKDIR, "under_test")
    yield "under_test"
    folder(board, p.OP_RMDIR, "under_test")
    assert not (board.root / OVERLAYS / "under_test").exists()


def text(board: Board, path: str) -> str:
    return (board.root / path).read_text().strip()


def module(board: Board) -> str | None:
    return board.control.state()["regions"]["prr0"]["module"]


def blob(**properties: bytes) -> bytes:
    named = {name.replace("_", "-"): value for name, value in properties.items()}
    return fdt.pack(fdt.overlay("/fpga-region", fdt.FdtNode("", named)))


def test_an_overlay_is_applied_and_can_be_read_back(board, overlay):
    assert text(board, f"{OVERLAYS}/{overlay}/status") == "unapplied"
    data = (board.root / FIRMWARE / "camera.dtbo").read_bytes()
    attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo", data)
    assert text(board, f"{OVERLAYS}/{overlay}/status") == "applied"
    assert attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo") == data
    assert refusal(attribute, board.root, f"{OVERLAYS}/{overlay}/dtbo", data) == errno.EPERM


def test_an_overlay_that_is_made_anew_holds_nothing_of_the_one_before(board):
    data = (board.root / FIRMWARE / "camera.dtbo").read_bytes()
    for name in ("one", "two", "one"):
        folder(board, p.OP_MKDIR, name)
        assert text(board, f"{OVERLAYS}/{name}/status") == "unapplied"
        assert [attribute(board.root, f"{OVERLAYS}/{name}/{file}") for file in ("dtbo", "path")] == [b"", b"\n"]
        attribute(board.root, f"{OVERLAYS}/{name}/dtbo", data)
        assert board.control.state()["overlays"] == [name]
        folder(board, p.OP_RMDIR, name)
        assert not [entry for entry in (board.root / OVERLAYS).iterdir() if entry.is_dir()]


def test_an_overlay_is_found_by_its_firmware_name(board, overlay):
    attribute(board.root, f"{OVERLAYS}/{overlay}/path", b"cm/camera/camera.dtbo\n")
    assert text(board, f"{OVERLAYS}/{overlay}/status") == "applied"
    assert board.control.state()["overlays"] == [overlay]


def test_an_overlay_that_is_not_a_device_tree_is_refused(board, overlay):
    for data in (b"", b"nonsense", blob()[:-8], fdt.pack(fdt.FdtNode("", {"a": b"b"}))):
        assert refusal(attribute, board.root, f"{OVERLAYS}/{overlay}/dtbo", data) == errno.EINVAL
    assert text(board, f"{OVERLAYS}/{overlay}/status") == "unapplied"


def test_an_overlay_with_a_firmware_name_loads_it(board, overlay):
    data = blob(firmware_name=b"cm/camera/edge.bin\0", partial_fpga_config=b"")
    attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo", data)
    assert module(board) == "edge"


def test_a_region_takes_no_second_firmware_until_the_first_overlay_is_removed(board, overlay):
    data = blob(firmware_name=b"cm/camera/edge.bin\0", partial_fpga_config=b"")
    folder(board, p.OP_MKDIR, "first")
    attribute(board.root, f"{OVERLAYS}/first/dtbo", data)
    assert refusal(attribute, board.root, f"{OVERLAYS}/{overlay}/dtbo", data) == errno.EINVAL
    folder(board, p.OP_RMDIR, "first")
    attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo", data)


def test_a_region_with_a_firmware_overlay_takes_no_other_overlay_at_all(board, overlay):
    attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo", blob(firmware_name=b"cm/camera/edge.bin\0"))
    folder(board, p.OP_MKDIR, "devices")
    assert refusal(attribute, board.root, f"{OVERLAYS}/devices/dtbo", blob(more=b"")) == errno.EINVAL
    elsewhere = fdt.pack(fdt.overlay("/another-region", fdt.FdtNode()))
    attribute(board.root, f"{OVERLAYS}/devices/dtbo", elsewhere)
    folder(board, p.OP_RMDIR, "devices")


def window(name: str, spi: int) -> bytes:
    found = {"compatible": b"fpga-cm,window\0fpga-cm,uio\0generic-uio\0"}
    found["interrupts"] = b"".join(cell.to_bytes(4, "big") for cell in (0, spi, 4))
    return fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [fdt.FdtNode(name, found)])))


def test_a_device_that_no_driver_takes_fails_the_overlay_and_is_named(board):
    overlays = Overlays(board.root)
    board.control.inject("probe_error", "control")
    with pytest.raises(DeviceError, match=r"40000000\.control \(fpga-cm,uio\) got no driver: uio_pdrv_genirq"):
        overlays.apply("faulty", window("control@40000000", 29))
    assert overlays.list() == []
    overlays.apply("faulty", window("control@40000000", 29))
    overlays.remove("faulty")


def test_an_interrupt_that_another_device_has_is_said_with_its_holder_and_what_frees_it(board):
    overlays = Overlays(board.root)
    overlays.apply("image", window("fabric@40000000", 29))
    with pytest.raises(DeviceError) as refused:
        overlays.apply("ours", window("control@40010000", 29))
    assert "40010000.control" in str(refused.value)
    assert "40000000.fabric (uio_pdrv_genirq) has its interrupt" in str(refused.value)
    assert "echo 40000000.fabric >/sys/bus/platform/drivers/uio_pdrv_genirq/unbind" in str(refused.value)
    overlays.apply("ours", window("control@40010000", 30))
    for name in ("ours", "image"):
        overlays.remove(name)


def test_an_overlay_whose_firmware_is_missing_is_not_applied(board, overlay):
    assert refusal(
        attribute, board.root, f"{OVERLAYS}/{overlay}/dtbo", blob(firmware_name=b"cm/camera/none.bin\0")
    ) == errno.ENOENT  # fmt: skip
    assert text(board, f"{OVERLAYS}/{overlay}/status") == "unapplied"


def test_an_injected_error_refuses_one_overlay(board, overlay):
    board.control.inject("overlay_error", overlay)
    assert refusal(attribute, board.root, f"{OVERLAYS}/{overlay}/dtbo", blob()) == errno.EINVAL
    attribute(board.root, f"{OVERLAYS}/{overlay}/dtbo", blob())


def test_folders_have_names_that_are_free(board, overlay):
    assert refusal(folder, board, p.OP_MKDIR, overlay) == errno.EEXIST
    assert refusal(folder, board, p.OP_RMDIR, "nobody") == errno.ENOENT
    for name in ("", "../up", "a/b", ".node", "a\nb"):
        assert refusal(folder, board, p.OP_MKDIR, name) == errno.EINVAL


def test_the_manager_loads_firmware_by_name(board):
    attribute(board.root, f"{MANAGER}/flags", b"1\n")
    assert attribute(board.root, f"{MANAGER}/flags") == b"1\n"
    attribute(board.root, f"{MANAGER}/firmware", b"cm/camera/default.bin\n")
    assert text(board, f"{MANAGER}/state") == "operating"
    assert module(board) == "default"


def test_the_manager_refuses_words_in_the_order_of_a_bit_file(board):
    assert refusal(attribute, board.root, f"{MANAGER}/firmware", b"cm/camera/wrong.bin") == errno.EINVAL
    assert text(board, f"{MANAGER}/state") == "write init error"


@pytest.mark.parametrize("name", [b"none.bin", b"../../dev/uio0", b"/etc/passwd", b""])
def test_the_manager_finds_firmware_in_its_folder_only(board, name):
    assert refusal(attribute, board.root, f"{MANAGER}/firmware", name) == errno.ENOENT
    assert text(board, f"{MANAGER}/state") == "firmware request error"


def test_an_injected_error_fails_one_load_of_the_manager(board):
    attribute(board.root, f"{MANAGER}/flags", b"1")
    board.control.inject("fpga_manager_error")
    assert refusal(attribute, board.root, f"{MANAGER}/firmware", b"cm/camera/edge.bin") == errno.EIO
    assert text(board, f"{MANAGER}/state") == "write error"
    attribute(board.root, f"{MANAGER}/firmware", b"cm/camera/edge.bin")
    assert text(board, f"{MANAGER}/state") == "operating"


def test_flags_that_are_not_a_number_are_refused(board):
    assert refusal(attribute, board.root, f"{MANAGER}/flags", b"often") == errno.EINVAL


def test_a_full_image_resets_registers_and_regions(board):
    attribute(board.root, f"{MANAGER}/flags", b"1")
    attribute(board.root, f"{MANAGER}/firmware", b"cm/camera/edge.bin")
    with Uio(board.root, "dev/uio0") as uio:
        uio.write(0x14, 5)
        attribute(board.root, f"{MANAGER}/flags", b"0")
        image = assemble("xc7z020", [FrameRun(FrameAddress(0, 20, 0), bytes(404 * 4))], partial=False)
        (board.root / FIRMWARE / "static.bin").write_bytes(to_dma_words(image))
        attribute(board.root, f"{MANAGER}/firmware", b"cm/camera/static.bin")
        assert uio.read(0x14) == 0
    assert module(board) is None

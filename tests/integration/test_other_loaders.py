# SPDX-License-Identifier: Apache-2.0
"""Another program loads the PL, or removes an overlay, while a manager runs: that says so, and serves nothing of it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from manager_process import CAMERA, Manager, environment, short_folder, until

import cm
from cm.client.errors import RequestFailed
from cm.device import FpgaManager, Overlays
from cm.formats import fdt
from cm.formats.bitstream.container import to_dma_words
from cm.simulation.software import Board as SimBoard

EDGE = "cm/camera/edge.bin"
APP = fdt.pack(
    fdt.overlay("/fpga-region", fdt.FdtNode("", {"firmware-name": f"{EDGE}\0".encode(), "partial-fpga-config": b""}))
)


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard([CAMERA], arguments=["--icap-rate", "0", "--pcap-rate", "0"]) as board:
        firmware = board.root / "lib/firmware"
        (firmware / EDGE).write_bytes(to_dma_words(firmware / "cm/camera/edge.bit"))
        yield board


@pytest.fixture
def board(sim: SimBoard) -> Iterator[cm.Board]:
    """A client of a manager, one of whose regions is loaded through the kernel."""
    with short_folder() as folder:
        (folder / "configs").mkdir()
        text = (CAMERA / "camera.yaml").read_text().replace("    prr1:\n", "    prr1:\n      loader: fpga_manager\n", 1)
        (folder / "configs/camera.yaml").write_text(text)
        places = ("--config", str(folder / "configs"), "--root", str(sim.root), "--state-dir", str(folder / "state"))
        manager = Manager(folder / "run", *places, env=environment()).start()
        with manager.connected() as connected:
            connected.load("camera", "default")
            yield connected
        assert manager.stop() == 0


def noticed(board: cm.Board) -> str:
    """What the status says of it, once it says so."""
    until(lambda: board.status.last_error and board.status.last_error.code == "other_loader", timeout=30)
    error = board.status.last_error
    assert error is not None
    return error.message


def nothing_is_served(board: cm.Board, what: str) -> None:
    status = board.status
    assert (status.config_name, status.mode) == ("", "")
    assert {region.state for region in status.regions} == {"unknown"}
    for request in (
        lambda: board.registers["focus"],
        lambda: board.registers.write({"led": 1}),
        lambda: board.check_region("prr0"),
        lambda: board.map_region("prr0"),
    ):
        with pytest.raises(RequestFailed) as refused:
            request()
        assert what in str(refused.value)


def test_an_image_that_was_loaded_by_hand(board: cm.Board, sim: SimBoard) -> None:
    FpgaManager(0, sim.root).load(EDGE, partial=True)  # as `fpgautil -f Partial -b edge.bin`
    said = noticed(board)
    assert said == (
        "by another program: fpga0 was told to load an image (it says 'operating'); nothing is known of what the PL "
        "holds: cm load brings a mode back"
    )
    nothing_is_served(board, "fpga0 was told to load an image")
    assert sim.control.state()["regions"]["prr0"]["module"] == "edge", "which the manager has left alone"
    board.load("camera", "default")
    assert sim.control.state()["regions"]["prr0"]["module"] == "default"
    assert board.registers["focus"] == 1
    board.load("camera", "edge_detection")
    assert board.status.last_error is None


def test_an_overlay_that_loads_and_nothing_that_we_have_loaded_ourselves(board: cm.Board, sim: SimBoard) -> None:
    for mode in ("loopback_edge", "default", "loopback"):  # with loads through the kernel
        board.load("camera", mode)
    Overlays(sim.root).apply("app", APP)  # as `xmutil loadapp`
    try:
        assert "overlay app was applied, which loads one; nothing is known" in noticed(board)
        nothing_is_served(board, "overlay app was applied")
    finally:
        Overlays(sim.root).remove("app")
    board.load("camera", "default")
    assert board.status.mode == "default"


def test_an_overlay_that_was_removed(board: cm.Board, sim: SimBoard) -> None:
    overlay = Overlays(sim.root).list()[-1]
    Overlays(sim.root).remove(overlay)
    assert noticed(board) == (
        f"by another program: overlay {overlay} was removed; the board is in no mode: cm load brings a mode back"
    )
    assert (board.status.config_name, board.status.mode) == ("camera", "")
    board.load("camera", "default")
    assert overlay in Overlays(sim.root).list()

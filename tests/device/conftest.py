# SPDX-License-Identifier: Apache-2.0
"""The board that the device suite runs on: ``--board=sim|rtl|vm|hw``, names from ``--board-file``.

``sim`` starts the user-space simulator, ``rtl`` the same with the design of tests/rtl/loop behind its nodes.
``vm`` and ``hw`` use the devices of this machine; what the suite cannot find out by itself stands in a JSON
file with the fields of `suite_board.Board`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from suite_board import PATIENCE, Board

import cm.device as device
from cm.formats.bitstream import to_dma_words

if TYPE_CHECKING:
    from cm.simulation.software import Board as Simulator

SCHEMA = Path(__file__).parents[2] / "cm/data/camera/camera.yaml"
LOOP = Path(__file__).parents[1] / "rtl/loop/build.yaml"
FIRMWARE = "lib/firmware/cm/camera"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--board", choices=("sim", "rtl", "vm", "hw"), default="sim", help="where the device suite runs")
    parser.addoption("--board-file", type=Path, help="JSON with the fields of tests/device/suite_board.py")


def _simulated() -> Iterator[Board]:
    from cm.simulation.software import Board as Simulator

    with Simulator([SCHEMA]) as simulator:
        yield Board(
            root=str(simulator.root),
            to_pl="to_pl",
            from_pl="from_pl",
            uio=device.find_uio(0x1000, 4, simulator.root)[0].node,
            scratch=0x14,
            memory=(0x800, 0x800),
            lend=(0x2000, 0x14),
            irq=device.find_uio(0x6000, 4, simulator.root)[0].node,
            acknowledge=(0x1024, 1),
            icap="cm_icap0",
            bitstream=str(simulator.root / FIRMWARE / "loopback.bit"),
            overlay=str(simulator.root / FIRMWARE / "camera.dtbo"),
            close_waits=False,  # its load goes on to the end, unheard
            raise_interrupt=lambda: simulator.control.interrupt("loop_done"),
            stall=partial(_stall, simulator),
        )


def _stall(simulator: Simulator, on: bool) -> None:
    if on:
        simulator.control.inject("icap_stall")
    else:
        simulator.control.clear("icap_stall")


def _rtl() -> Iterator[Board]:
    from cm.simulation.rtl.main import prepare
    from cm.simulation.software import Board as Simulator

    prepare(LOOP)
    with (
        Simulator(
            program="cm.simulation.rtl", arguments=["--build", str(LOOP), "--icap-rate", "10000000"]
        ) as simulator,
        device.Uio.open(0x4000_0000, simulator.root) as control,
        device.Uio.open(0x4001_0000, simulator.root) as left,
    ):

        def decouple(cut: bool) -> None:
            control.write(0x100, cut)
            while control.read(0x108) & 1 != cut:
                pass

        board = Board(
            root=str(simulator.root),
            to_pl="to_left",
            from_pl="from_left",
            uio=left.info.node,
            scratch=0x10,
            memory=(0x800, 0x800),
            irq=control.info.node,
            acknowledge=(0x008, 1),
            icap="cm_icap0",
            bitstream=str(simulator.root / "lib/firmware/cm/loop/plain.bin"),
            overlay=str(simulator.root / "lib/firmware/cm/loop/loop_static.dtbo"),
            close_waits=False,
            raise_interrupt=lambda: left.write(0x14, 1),
            stall=partial(_stall, simulator),
            decouple=decouple,
        )
        control.write(0x00C, 1)  # IRQ_ENABLE
        decouple(True)
        _load(board)
        decouple(False)
        yield board


def _of_this_machine(path: Path | None) -> Board:
    """Return the board of the file; channels that it does not name are the first of each direction."""
    given = json.loads(path.read_text()) if path else {}
    root = given.get("root", "/")
    names: dict[device.Direction, str] = {}
    for name in device.list_dma(root):
        with device.AxiDma.open(name, root) as channel:
            names.setdefault(channel.info.direction, name)
    found = {
        "to_pl": names.get(device.Direction.MM2S),
        "from_pl": names.get(device.Direction.S2MM),
        "icap": next(iter(device.list_icap(root)), None),
    }
    return Board(**{**found, **given})


@pytest.fixture(scope="session")
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    """The board, with a circuit loaded that loops ``to_pl`` to ``from_pl``."""
    # The default is for runs whose command line does not name this folder: pytest reads it too late then.
    kind = request.config.getoption("--board", "sim")
    if kind == "rtl":
        yield from _rtl()
    elif kind == "sim":
        for simulated in _simulated():
            _load(simulated)
            yield simulated
    else:
        found = _of_this_machine(request.config.getoption("--board-file", None))
        if found.icap and found.bitstream:
            _load(found)
        yield found


def _load(board: Board) -> None:
    words = to_dma_words(Path(board.bitstream or "").read_bytes())
    with device.Icap.open(board.icap or "", board.root) as icap, icap.allocate(len(words)) as buffer:
        buffer.array(0, len(words))[:] = bytearray(words)
        icap.load(buffer, len(words))
        assert icap.wait(PATIENCE).ok


@pytest.fixture
def loop(board: Board) -> Iterator[tuple[device.AxiDma, device.AxiDma]]:
    """The looped channels, (to the PL, from the PL), open."""
    if board.to_pl is None or board.from_pl is None:
        pytest.skip("the board has no looped pair of DMA channels")
    with device.AxiDma.open(board.to_pl, board.root) as out, device.AxiDma.open(board.from_pl, board.root) as back:
        yield out, back


@pytest.fixture
def uio(board: Board) -> Iterator[device.Uio]:
    """The UIO device with the scratch register."""
    if board.uio is None:
        pytest.skip("the board has no UIO device for tests")
    with device.Uio.open(board.uio, board.root) as opened:
        yield opened


@pytest.fixture
def icap(board: Board) -> Iterator[device.Icap]:
    """The configuration port; each test leaves a good bitstream loaded."""
    if board.icap is None:
        pytest.skip("the board has no ICAP")
    decouple = board.decouple or (lambda _: None)
    with device.Icap.open(board.icap, board.root) as opened:
        decouple(True)
        yield opened
        decouple(False)


@pytest.fixture
def words(board: Board) -> bytes:
    """The good bitstream in the port's byte order."""
    if board.bitstream is None:
        pytest.skip("no bitstream for this board is given")
    return to_dma_words(Path(board.bitstream).read_bytes())

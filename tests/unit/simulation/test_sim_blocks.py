# SPDX-License-Identifier: Apache-2.0
"""An imported design on the simulated board: its blocks do what their VLNVs say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from import_support import bitstream, buses, described, hwh, memory, module, port, ports, register, register_field
from manager_process import served, short_folder

import cm
from cm.errors import Timeout
from cm.formats.importers import import_pynq, write

KERNEL = described(
    register(
        "CTRL",
        0,
        register_field("AP_START", 0, 1),
        register_field("AP_DONE", 1, 1, "read-only"),
        register_field("AP_IDLE", 2, 1, "read-only"),
        register_field("AP_READY", 3, 1, "read-only"),
        register_field("AUTO_RESTART", 7, 1),
        RESET_VALUE="0x0",
    ),
    register("GIER", 4, register_field("Enable", 0, 1)),
    register("IP_IER", 8, register_field("CHAN0_INT_EN", 0, 1), register_field("CHAN1_INT_EN", 1, 1)),
    register(
        "IP_ISR",
        0xC,
        register_field("CHAN0_INT_ST", 0, 1, MODIFIED_WRITE_VALUE="oneToToggle"),
        register_field("CHAN1_INT_ST", 1, 1, MODIFIED_WRITE_VALUE="oneToToggle"),
    ),
    register("a", 0x10),
    register("b", 0x18),
)
INTERRUPTS = (("kernel", "interrupt"), ("timer", "interrupt"), ("gpio", "ip2intc_irpt"))
DESIGN = hwh(
    module(
        "ps",
        "processing_system7",
        ports(port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=3)),
        memory(
            ("kernel", 0x40000000, 0x10000),
            ("dma", 0x40400000, 0x10000),
            ("gpio", 0x41200000, 0x10000),
            ("uart", 0x42C00000, 0x10000),
            ("timer", 0x42800000, 0x10000),
            ("odd", 0x43C00000, 0x10000),
            ("deaf", 0x40410000, 0x10000),
            ("told", 0x40420000, 0x10000),
            ("plain", 0x40430000, 0x10000),
        ),
    ),
    module(
        "concat",
        "xlconcat",
        ports(
            port("dout", "O", ("ps", "IRQ_F2P"), bits=3),
            *(port(f"In{at}", "I", end) for at, end in enumerate(INTERRUPTS)),
        ),
    ),
    module("kernel", "kernel", KERNEL, ports(port("interrupt", "O", ("concat", "In0"), kind="INTERRUPT"))),
    module("timer", "axi_timer", ports(port("interrupt", "O", ("concat", "In1"), kind="INTERRUPT"))),
    module("gpio", "axi_gpio", ports(port("ip2intc_irpt", "O", ("concat", "In2"), kind="INTERRUPT"))),
    module("uart", "axi_uartlite"),
    module("odd", "odd", buses(("S", "SLAVE", "c"), ("M", "MASTER", "d"))),
    module("dma", "axi_dma", buses(("M_AXIS_MM2S", "MASTER", "a"), ("S_AXIS_S2MM", "SLAVE", "e"))),
    module("fifo", "axis_data_fifo", buses(("S_AXIS", "SLAVE", "a"), ("M_AXIS", "MASTER", "b"))),
    module("negate", "negate", buses(("x", "SLAVE", "b"), ("y", "MASTER", "e"))),
    module("deaf", "axi_dma", buses(("M_AXIS_MM2S", "MASTER", "c"), ("S_AXIS_S2MM", "SLAVE", "d"))),
    module("told", "axi_dma", buses(("M_AXIS_MM2S", "MASTER", "f"), ("S_AXIS_S2MM", "SLAVE", "g"))),
    module("plain", "plain", KERNEL, buses(("S", "SLAVE", "f"), ("M", "MASTER", "g"))),
)
MODELS = """
from cm.simulation.software import HlsKernel, Model


class Negate(Model):
    def frame(self, stream, frame):
        print(f"{self.name} has {frame.size} bytes of {stream}")
        return 255 - frame


class Doubles(HlsKernel):
    def work(self):
        self.registers["b"] = 2 * self.registers["a"]


MODELS = {"xilinx.com:ip:negate": Negate, "xilinx.com:ip:kernel:1.0": Doubles}
"""


@contextmanager
def loaded() -> Iterator[cm.Board]:
    with short_folder() as folder:
        (folder / "all.bit").write_bytes(bitstream())
        (folder / "all.hwh").write_bytes(DESIGN)
        write(import_pynq(folder / "all.bit"), folder)
        (folder / "models.py").write_text(MODELS)
        options = ("--models", str(folder / "models.py"))
        with served(schemas=folder, board=options) as (manager, _), manager.connected() as found:
            found.load("all")
            yield found


@pytest.fixture(scope="module")
def board() -> Iterator[cm.Board]:
    with loaded() as found:
        yield found


def moved(board: cm.Board, engine: str, data: np.ndarray) -> np.ndarray:
    for name in (f"{engine}_mm2s", f"{engine}_s2mm"):
        board.configure_stream(name, shape=(data.size,), dtype="uint8")
    with board.stream(f"{engine}_s2mm") as results, board.writer(f"{engine}_mm2s") as writer:
        writer.write(data)
        return np.array(results.read(2.0))


def test_a_stream_goes_where_the_design_leads_it(board: cm.Board) -> None:
    data = np.arange(64, dtype=np.uint8)
    assert (moved(board, "dma", data) == 255 - data).all()
    assert (moved(board, "told", data) == data).all()
    with pytest.raises(Timeout):
        moved(board, "deaf", data)


def test_a_kernel_of_hls_starts_is_done_once_and_interrupts(board: cm.Board) -> None:
    kernel = board.blocks["kernel"]
    assert kernel.read(0) == 4
    kernel.registers.update({"gier": 1, "ip_ier": 3, "a": 21})
    kernel.write(0, 1)
    done, _ = (board.interrupts[name] for name in kernel.info.interrupts)
    done.wait(60)
    assert [kernel.read(0), kernel.read(0), kernel.registers["b"]] == [0xE, 4, 42]
    assert kernel.registers["ip_isr"] & 1 == 0
    kernel.write(0, 0x81)
    counts = done.count
    while done.count < counts + 2:
        done.wait(60)
    kernel.write(0, 0)


def test_a_timer_counts_down_and_interrupts(board: cm.Board) -> None:
    timer = board.blocks["timer"]
    timer.registers["tlr0"] = 100_000
    timer.write(0, 0x20)
    assert timer.read(8) == 100_000
    timer.write(0, 0xC2)
    board.interrupts[timer.info.interrupts[0]].wait(60)
    assert timer.read(8) == 0


def test_ones_toggle_the_status_of_a_gpio(board: cm.Board) -> None:
    gpio = board.blocks["gpio"]
    gpio.write(0, 5)
    gpio.write(0x120, 1)
    assert (gpio.read(0), gpio.read(0x120)) == (5, 1)
    gpio.write(0x120, 1)
    assert gpio.read(0x120) == 0


def test_what_has_no_model_is_told_once_and_what_models_print_is_seen(capfd: pytest.CaptureFixture[str]) -> None:
    with loaded() as board:
        uart = board.blocks["uart"]
        for letter in b"hello\n":
            assert uart.read(8) & 4
            uart.write(4, letter)
        moved(board, "dma", np.zeros(8, np.uint8))
    said = capfd.readouterr().err.splitlines()
    assert [line for line in said if "has no model" in line] == [
        "cm sim: odd (xilinx.com:ip:odd:1.0) of all has no model: registers keep what is written, streams give nothing",
        "cm sim: plain (xilinx.com:ip:plain:1.0) of all has no model: registers keep what is written, "
        "streams pass unchanged",
    ]
    assert {"uart: hello", "negate has 8 bytes of dma_mm2s"} <= {*said}

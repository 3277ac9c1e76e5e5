# SPDX-License-Identifier: Apache-2.0
"""Programs of PYNQ's, unchanged, on a simulated board with a design that `cm import pynq` took over."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from import_support import (
    bitstream,
    described,
    hwh,
    memory,
    module,
    port,
    ports,
    register,
    register_field,
)
from manager_process import Manager, environment, served, short_folder, until

import cm
from cm import pynq
from cm.client.blocks import Block, _drivers
from cm.errors import Busy, InvalidRequest, NotFound
from cm.formats.importers import import_pynq, write
from cm.pynq.board import board, places
from cm.pynq.lib import DMA, AxiGPIO
from cm.pynq.lib.dma import _channel
from cm.simulation.software import Board as SimBoard

FILTER = described(
    register(
        "CTRL",
        0,
        register_field("AP_START", 0, 1),
        register_field("AP_DONE", 1, 1, "read-only"),
        register_field("MODE", 4, 4),
    ),
    register("rows", 0x10, access="write-only"),
    register("status", 0x14, access="read-only", RESET_VALUE="0x80"),
    register("gain", 0x18),
    register("ISR", 0x20, register_field("DONE", 0, 1, MODIFIED_WRITE_VALUE="oneToClear")),
)
CONTROL = described(register("S2MM_DMACR", 0x30, register_field("RS", 0, 1), register_field("Reset", 2, 1)))
BRAM = 0x42000000


def design() -> bytes:
    """A filter, a GPIO with an interrupt, an AXI DMA (its loop is closed by the board), block RAM, a clock."""
    return hwh(
        module(
            "ps",
            "processing_system7",
            ports(port("IRQ_F2P", "I", ("gpio", "ip2intc_irpt"), kind="INTERRUPT")),
            memory(
                ("filter", 0x40000000, 0x10000),
                ("dma", 0x40400000, 0x10000),
                ("gpio", 0x41200000, 0x10000),
                ("ram", BRAM, 0x1000),
            ),
            parameters={"PCW_FPGA_FCLK0_ENABLE": "1", "PCW_ACT_FPGA0_PERIPHERAL_FREQMHZ": "100.0"},
        ),
        module("filter", "filter", FILTER),
        module("dma", "axi_dma", CONTROL, parameters={"C_INCLUDE_MM2S": "1", "C_INCLUDE_S2MM": "1"}),
        module("gpio", "axi_gpio", ports(port("ip2intc_irpt", "O", ("ps", "IRQ_F2P"), kind="INTERRUPT"))),
        module("ram", "axi_bram_ctrl"),
    )


@pytest.fixture(scope="module")
def design_folder() -> Iterator[Path]:
    with short_folder() as folder:
        (folder / "cam.bit").write_bytes(bitstream())
        (folder / "cam.hwh").write_bytes(design())
        write(import_pynq(folder / "cam.bit"), folder)
        yield folder


@pytest.fixture(scope="module")
def both(design_folder: Path) -> Iterator[tuple[Manager, SimBoard]]:
    with served(schemas=design_folder) as found:
        yield found


@pytest.fixture
def bit(both: tuple[Manager, SimBoard], design_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The overlay's bitstream; cm.pynq talks to the board."""
    monkeypatch.setenv("CM_CONNECT", str(both[0].runtime))
    yield str(design_folder / "cam.bit")
    board().close()
    board.cache_clear()
    places.cache_clear()
    _channel.cache_clear()


@pytest.fixture
def overlay(bit: str) -> pynq.Overlay:
    return pynq.Overlay(bit)


def test_an_overlay_is_loaded_and_lists_its_blocks(overlay: pynq.Overlay) -> None:
    assert board().status.config_name == "cam"
    assert overlay.is_loaded()
    assert sorted(overlay.ip_dict) == ["dma", "filter", "gpio", "ram"]
    found = overlay.ip_dict["filter"]
    assert (found["phys_addr"], found["addr_range"], found["type"]) == (0x40000000, 0x10000, "xilinx.com:ip:filter:1.0")
    assert found["registers"]["CTRL"]["fields"]["MODE"]["bit_offset"] == 4


def test_registers_are_read_and_written_by_offset(overlay: pynq.Overlay) -> None:
    overlay.filter.write(0x18, 7)
    assert overlay.filter.read(0x18) == 7
    assert board().registers["filter_gain"] == 7
    overlay.filter.write(0x18, -1)
    assert overlay.filter.mmio.read(0x18) == 0xFFFFFFFF
    overlay.filter.write(0x10, np.int64(480))
    assert overlay.filter.read(0x10) == 480


def test_words_are_loaded_from_a_window_until_the_design_is_loaded_anew(overlay: pynq.Overlay) -> None:
    def asked() -> int:
        return sum(client.requests for client in board().clients())

    found = overlay.filter
    found.write(0x18, 7)
    overlay.ram.mmio.array[2] = 9
    assert (found.read(0x18), overlay.ram.read(8)) == (7, 9)
    before = asked()
    assert {(found.read(0x18), overlay.ram.read(8)) for _ in range(100)} == {(7, 9)}
    assert asked() - before == 1
    assert {window.writes for window in board().status.windows} == {False}
    overlay.download()
    assert found.read(0x18) == 0
    assert found.mmio.read(0x18, 2) == 0


def test_fields_and_bits_of_a_register_map(overlay: pynq.Overlay) -> None:
    found = overlay.filter.register_map
    found.CTRL = 0
    found.CTRL.MODE = 9
    assert (found.CTRL.MODE, int(found.CTRL), found.CTRL[7:4]) == (9, 0x90, 9)
    found.gain = -5
    assert int(found.gain) == 0xFFFFFFFB
    found.CTRL[0] = 1
    assert board().registers["filter_ctrl"] & 0xF1 == 0x91
    assert repr(found.CTRL) == "Register(AP_START=1, AP_DONE=0, MODE=9)"
    assert "  rows = Register(value=write-only)" in repr(found)


def test_a_block_of_the_board_has_what_the_overlay_has(overlay: pynq.Overlay) -> None:
    blocks = board().blocks
    assert sorted(blocks) == ["dma", "filter", "gpio", "ram"]
    found = blocks["filter"]
    assert (found.vlnv, list(found.registers)) == (
        "xilinx.com:ip:filter:1.0",
        ["ctrl", "rows", "status", "gain", "isr"],
    )
    found.write(0x18, 9)
    found.registers["ctrl"] = 0
    found.registers["ctrl.mode"] = 3
    assert (found.registers["gain"], found.read(0x18), found.registers["ctrl"]) == (9, 9, 0x30)
    found.write(0x18, -2)
    blocks["ram"].words[2:5] = [5, 6, 7]
    assert (found.words[6], blocks["ram"].words[2:5].tolist(), blocks["ram"].read(12)) == (0xFFFFFFFE, [5, 6, 7], 6)
    assert (blocks["gpio"].info.interrupts, blocks["ram"].memory.info.size) == (
        ("gpio_ip2intc_irpt", "gpio_ip2intc_irpt_2"),
        0x1000,
    )
    for wrong, error, said in (
        (lambda: found.read(0x10000), IndexError, "no word at 0x10000 in block 'filter'"),
        (lambda: found.registers["gian"], NotFound, "no register 'gian'; there are ctrl, rows"),
        (lambda: blocks["gpio"].interrupt, NotFound, "several of them: gpio_ip2intc_irpt, gpio"),
        (lambda: found.write(0x18, 1.5), ValueError, "a word is an integer, not float"),
        (lambda: found.memory, NotFound, "block 'filter' has no memory"),
        (lambda: blocks["fliter"], KeyError, "no block 'fliter'; there are filter, dma"),
    ):
        with pytest.raises(error, match=said):
            wrong()


def test_a_class_that_a_vlnv_is_bound_to_is_what_a_block_is(overlay: pynq.Overlay) -> None:
    @cm.driver("xilinx.com:ip:filter")
    class Filter(Block):
        def start(self) -> None:
            self.registers["ctrl"] = 1

    try:
        found = board().blocks["filter"]
        assert isinstance(found, Filter)
        found.start()
        assert found.read(0) & 1
    finally:
        del _drivers["xilinx.com:ip:filter"]


def test_memory_is_an_array(overlay: pynq.Overlay) -> None:
    window = pynq.MMIO(BRAM, 0x1000)
    window.array[0:4] = [1, 2, 3, 4]
    window.write(16, b"\5\0\0\0\6\0\0\0")
    assert window.array[:6].tolist() == [1, 2, 3, 4, 5, 6]
    assert window.read(16, 8) == 6 << 32 | 5


def test_gpio(overlay: pynq.Overlay) -> None:
    assert isinstance(overlay.gpio, AxiGPIO)
    leds = overlay.gpio.channel1
    leds.setdirection("out")
    leds[0:4].write(9)
    leds[1].toggle()
    assert board().registers["gpio_gpio_data"] == 0b1011


def test_a_buffer(overlay: pynq.Overlay) -> None:
    with pynq.allocate((16, 4), "u2") as buffer:
        assert (buffer.shape, buffer.dtype, buffer[2:].physical_address) == (
            (16, 4),
            "u2",
            buffer.physical_address + 16,
        )
        buffer.flush()
        with pytest.raises(InvalidRequest, match="ordinary memory"):
            _ = (buffer + 1).physical_address


def test_a_transfer_there_and_back(overlay: pynq.Overlay) -> None:
    assert isinstance(overlay.dma, DMA)
    source, result = pynq.allocate(1000, "u4"), pynq.allocate(1200, "u4")
    for base in (0, 5000):
        source[:] = np.arange(1000) + base
        overlay.dma.recvchannel.transfer(result, 400, 4000)
        overlay.dma.sendchannel.transfer(source)
        overlay.dma.sendchannel.wait()
        overlay.dma.recvchannel.wait()
        assert overlay.dma.recvchannel.idle
        assert overlay.dma.recvchannel.transferred == 4000
        assert (result[100:1100] == source).all()
        there = result.physical_address + 400
        assert (overlay.dma.mmio.read(0x48), overlay.dma.mmio.read(0x34)) == (there & 0xFFFFFFFF, 0x1002)


def test_a_program_drives_a_dma_by_its_registers(overlay: pynq.Overlay) -> None:
    dma, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(96, "u1")
    source[:] = range(64)
    for way, array in ((0x30, result[32:]), (0x00, source)):
        dma.write(way, 4)
        assert dma.read(way + 4) & 3 == 1
        dma.write(way, 0x1001)
        dma.write(way + 0x18, array.physical_address)
        dma.write(way + 0x1C, array.physical_address >> 32)
        dma.write(way + 0x28, 64)
    until(lambda: dma.read(0x34) & dma.read(0x04) & 0x1000)
    assert (dma.read(0x58), result.tolist()) == (64, [0] * 32 + source.tolist())
    control = dma.register_map.S2MM_DMACR
    control.Reset = 1
    assert (control.Reset, control.RS, dma.recvchannel.running) == (0, 0, False)
    control.RS = 1
    dma.recvchannel.transfer(result)
    dma.sendchannel.transfer(source)
    dma.recvchannel.wait()
    assert result[:64].tolist() == source.tolist()


def test_what_comes_is_in_the_buffer_without_anybody_who_waits(overlay: pynq.Overlay) -> None:
    source, result = pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    source[:] = 7
    overlay.dma.recvchannel.transfer(result)
    overlay.dma.sendchannel.transfer(source)
    until(lambda: result.tolist() == [7] * 64)
    assert overlay.dma.recvchannel.transferred == 64


def test_a_memory_window_is_written_in_part_and_read_by_steps(overlay: pynq.Overlay) -> None:
    words = overlay.ram.mmio.array
    words[:] = 0
    words[8:16:2] = np.arange(4)
    words[-1] = 0xFFFFFFFF
    assert words[8:16].tolist() == [0, 0, 1, 0, 2, 0, 3, 0]
    assert (words[len(words) - 1], np.asarray(words).shape) == (0xFFFFFFFF, (1024,))


@pytest.mark.parametrize(
    ("wrong", "error", "said"),
    [
        (lambda ip: ip.read(0x10000), IndexError, "not in this window of 0x10000 bytes"),
        (lambda ip: ip.read(2), MemoryError, "multiple of 4"),
        (lambda ip: ip.read(-4), ValueError, "negative"),
        (lambda ip: ip.read(0x1C), NotFound, "neither a register nor a memory at 0x4000001c"),
        (lambda ip: ip.write(0x18, 1 << 32), ValueError, "4294967296 is not a number of 32 bits"),
        (lambda ip: ip.write(0x18, 1.5), ValueError, "an integer, not float"),
        (lambda ip: ip.mmio.write(0x18, b"abc"), MemoryError, "multiple of 4"),
        (lambda ip: setattr(ip.register_map, "CTLR", 1), AttributeError, "no 'CTLR'; there are: CTRL"),
        (lambda ip: setattr(ip.register_map.CTRL, "MODE", 16), ValueError, "4 bits hold 0 to 15"),
        (lambda ip: setattr(ip.register_map.CTRL, "MODE", -1), ValueError, "4 bits hold 0 to 15"),
        (lambda ip: setattr(ip.register_map.CTRL, "MODE", 3.5), ValueError, "3.5 is not a whole number"),
        (lambda ip: setattr(ip.register_map, "gain", 2.5), ValueError, "2.5 is not a whole number"),
        (lambda ip: setattr(ip.register_map.CTRL, "AP_DONE", 1), AttributeError, "AP_DONE is read-only"),
        (lambda ip: setattr(ip.register_map, "status", 1), AttributeError, "0x14 is read-only"),
        (lambda ip: ip.register_map.gain[40], ValueError, "bits 40 to 40 are not in range 31 to 0"),
    ],
)
def test_what_is_wrong_is_refused_with_a_sentence(
    overlay: pynq.Overlay, wrong: Callable[[Any], object], error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        wrong(overlay.filter)


def test_a_lease_of_another_holds(overlay: pynq.Overlay, both: tuple[Manager, SimBoard]) -> None:
    with both[0].connected() as other, other.lease("registers:filter_gain"), pytest.raises(Busy):
        overlay.filter.write(0x18, 1)


def test_a_transfer_takes_bytes_of_its_buffer_alone(overlay: pynq.Overlay) -> None:
    buffer, channel = pynq.allocate(64), overlay.dma.sendchannel
    for array, start, nbytes in (
        (buffer, 0, 257),
        (buffer, 256, 0),
        (buffer, -4, 4),
        (buffer, 0, -64),
        (buffer[::2], 0, 0),
    ):
        with pytest.raises(ValueError):
            channel.transfer(array, start, nbytes)
    with pytest.raises(InvalidRequest, match="ordinary memory"):
        channel.transfer(buffer + 1)
    with pytest.raises(TypeError, match="arrays of allocate"):
        channel.transfer(np.zeros(4))
    for address, length in ((buffer.physical_address, 0), (buffer.physical_address + 4, 256), (0x1000, 4)):
        overlay.dma.write(0x18, address)
        with pytest.raises((ValueError, NotFound), match=r"not in one piece|no buffer that this program"):
            overlay.dma.write(0x28, length)
    with pytest.raises(NotImplementedError, match="a DMA's other registers are the driver's"):
        overlay.dma.write(0x08, buffer.physical_address)


def test_a_packet_that_ends_early_says_how_much_came(overlay: pynq.Overlay) -> None:
    dma, source, result = overlay.dma, pynq.allocate(100, "u1"), pynq.allocate(400, "u1")
    source[:] = 7
    dma.recvchannel.transfer(result)
    dma.sendchannel.transfer(source)
    dma.recvchannel.wait()
    assert (dma.recvchannel.transferred, int(result.sum())) == (100, 700)


def test_a_packet_waits_for_the_transfer_that_takes_it(overlay: pynq.Overlay) -> None:
    dma, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    assert not dma.recvchannel.idle
    for value in (1, 2, 3):
        source[:] = value
        dma.sendchannel.transfer(source)
        dma.recvchannel.transfer(result)
        dma.recvchannel.wait()
        dma.sendchannel.wait()
        assert result.tolist() == [value] * 64


def test_a_transfer_leaves_no_byte_beside_its_own(overlay: pynq.Overlay) -> None:
    dma, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    source[:], result[:] = range(64), 255
    dma.recvchannel.transfer(result[8:40], 4, 16)
    dma.sendchannel.transfer(source, 16, 16)
    dma.recvchannel.wait()
    assert result.tolist() == [255] * 12 + list(range(16, 32)) + [255] * 36


def test_any_buffers_of_the_program_are_transferred_and_those_of_another_are_not(
    overlay: pynq.Overlay, both: tuple[Manager, SimBoard]
) -> None:
    dma, results = overlay.dma, [pynq.allocate(64 + i, "u1") for i in range(5)]
    for round_ in range(3):
        for i, result in enumerate(results):
            source = pynq.allocate(64, "u1")
            source[:] = 10 * round_ + i
            dma.recvchannel.transfer(result)
            dma.sendchannel.transfer(source)
            dma.recvchannel.wait()
            dma.sendchannel.wait()
            assert result[:64].tolist() == source.tolist()
            source.freebuffer()
    gone = pynq.allocate(64, "u1")
    gone.freebuffer()
    dma.sendchannel.transfer(gone)
    with pytest.raises(RuntimeError, match=r"dma_mm2s.*Bad address"):
        dma.sendchannel.wait()
    with both[0].connected() as other, pytest.raises(Busy, match=r"dma_mm2s.*in use by pid"):
        other.writer("dma_mm2s")


@pytest.mark.parametrize("ends", ["wait", "stop"])
def test_a_buffer_that_is_freed_during_a_transfer_goes_at_its_end(
    overlay: pynq.Overlay, both: tuple[Manager, SimBoard], ends: str
) -> None:
    dma, source, before = overlay.dma, pynq.allocate(64, "u1"), both[1].control.state()["memory"]
    result = pynq.allocate(64, "u1")
    source[:] = 4
    dma.recvchannel.transfer(result)
    result.freebuffer()
    dma.sendchannel.transfer(source)
    for channel in (dma.sendchannel, dma.recvchannel):
        getattr(channel, ends)()
        channel.start()
    assert ends == "stop" or result.tolist() == [4] * 64
    assert until(lambda: both[1].control.state()["memory"] <= before)


@pytest.mark.parametrize("name", ["dma_mm2s", "dma_s2mm"])
def test_a_transfer_that_fails_raises_with_the_reason_and_the_next_one_works(
    overlay: pynq.Overlay, both: tuple[Manager, SimBoard], name: str
) -> None:
    dma, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    both[1].control.inject("dma_error", name)
    dma.recvchannel.transfer(result)
    dma.sendchannel.transfer(source)
    failing = dma.sendchannel if name == "dma_mm2s" else dma.recvchannel
    with pytest.raises(RuntimeError, match=name):
        failing.wait()
    assert failing.error
    dma.recvchannel.stop()
    dma.sendchannel.stop()
    with pytest.raises(RuntimeError, match="DMA channel not started"):
        dma.sendchannel.transfer(source)
    for channel in (dma.recvchannel, dma.sendchannel):
        channel.start()
    source[:] = 3
    dma.recvchannel.transfer(result)
    dma.sendchannel.transfer(source)
    dma.recvchannel.wait()
    assert result.tolist() == [3] * 64


def test_a_transfer_is_awaited_while_other_tasks_run(overlay: pynq.Overlay) -> None:
    dma, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    source[:] = 9

    async def send() -> None:
        dma.sendchannel.transfer(source)
        await dma.sendchannel.wait_async()

    async def both_ways() -> None:
        await asyncio.gather(dma.recvchannel.wait_async(), send())

    dma.recvchannel.transfer(result)
    with pytest.raises(RuntimeError, match="not idle"):
        dma.recvchannel.transfer(result)
    asyncio.run(both_ways())
    assert result.tolist() == [9] * 64


def test_a_channel_goes_on_after_the_overlay_was_loaded_again(overlay: pynq.Overlay) -> None:
    kept, source, result = overlay.dma, pynq.allocate(64, "u1"), pynq.allocate(64, "u1")
    for again in (overlay, pynq.Overlay(overlay.bitfile_name)):
        for dma in (kept, again.dma):
            source[:] = result[0] + 1
            dma.recvchannel.transfer(result)
            dma.sendchannel.transfer(source)
            dma.recvchannel.wait()
            dma.sendchannel.wait()
            assert result.tolist() == source.tolist()
        again.download()


def test_an_interrupt_is_awaited(overlay: pynq.Overlay, both: tuple[Manager, SimBoard]) -> None:
    async def wait() -> None:
        waiting = asyncio.create_task(overlay.gpio.ip2intc_irpt.wait())
        await asyncio.sleep(0)
        both[1].control.interrupt("gpio_ip2intc_irpt")
        await asyncio.wait_for(waiting, 60)

    asyncio.run(wait())
    assert board().interrupts["gpio_ip2intc_irpt"].count >= 1


def test_a_class_is_bound_by_vlnv_with_and_without_its_version(overlay: pynq.Overlay) -> None:
    class Filter(pynq.DefaultIP):
        bindto = ("xilinx.com:ip:filter:2.0",)

        @property
        def gain(self) -> int:
            return self.read(0x18)

    try:
        overlay.filter.write(0x18, 5)
        found = pynq.Overlay(overlay.bitfile_name, download=False).filter
        assert (type(found), found.gain) == (Filter, 5)
    finally:
        for vlnv in ("xilinx.com:ip:filter:2.0", "xilinx.com:ip:filter"):
            del pynq.DefaultIP.drivers[vlnv]


def test_clocks_are_read_and_belong_to_the_configuration(overlay: pynq.Overlay) -> None:
    assert pynq.Clocks.fclk0_mhz == pytest.approx(100, rel=0.01)
    with pytest.raises(NotImplementedError, match="`clocks:` of its schema"):
        pynq.Clocks.fclk0_mhz = 50


def test_an_overlay_without_a_configuration_says_how_to_make_one(bit: str, tmp_path: Path) -> None:
    (tmp_path / "other.bit").write_bytes(Path(bit).read_bytes())
    (tmp_path / "other.hwh").write_bytes(design())
    with pytest.raises(NotFound, match=r"no configuration 'other': `cm import pynq .*other.bit --out DIR`.*restart"):
        pynq.Overlay(str(tmp_path / "other.bit"))
    assert not pynq.Overlay(str(tmp_path / "other.bit"), download=False).is_loaded()
    with pytest.raises(FileNotFoundError, match=r"none\.bit does not exist\. Name the one that was imported"):
        pynq.Overlay("none.bit")


PROGRAM = """
import numpy as np
from pynq import MMIO, Overlay, allocate

overlay = Overlay("cam.bit")
dma = overlay.dma
source = allocate(shape=(100,), dtype=np.uint32)
result = allocate(shape=(100,), dtype=np.uint32)
source[:] = np.arange(100)
dma.recvchannel.transfer(result)
dma.sendchannel.transfer(source)
dma.sendchannel.wait()
dma.recvchannel.wait()
overlay.filter.register_map.gain = 3
print(int(result.sum()), MMIO(0x40000000, 0x100).read(0x18), hex(overlay.filter.register_map.gain))
"""


def test_a_program_of_pynqs_runs_unchanged(bit: str, both: tuple[Manager, SimBoard], tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, "-m", "cm.pynq", str(tmp_path / "program.py")],
        capture_output=True,
        text=True,
        check=False,
        cwd=Path(bit).parent,
        env=environment(CM_CONNECT=str(both[0].runtime)),
        timeout=60,
    )
    assert done.stdout == "4950 3 0x3\n", done.stderr

# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from import_support import (
    described,
    hwh,
    memory,
    memory_range,
    module,
    port,
    ports,
    register,
    register_field,
)

from cm.formats import hwh as handoff
from cm.formats.hwh import ConnectedPort, Hwh, HwhError

PS = "processing_system7"


def interrupt_design(*more: str) -> Hwh:
    """cam.irq → concat input 0; dma.introut → concat input 1; concat → axi_intc → PS."""
    return handoff.parse(
        hwh(
            module("ps", PS, ports(port("IRQ_F2P", "I", ("intc", "irq"), kind="INTERRUPT"))),
            module("intc", "axi_intc", ports(port("intr", "I", ("concat", "dout"), kind="INTERRUPT", bits=2))),
            module(
                "concat", "xlconcat", ports(port("In1", "I", ("dma", "s2mm_introut")), port("In0", "I", ("cam", "irq")))
            ),
            module("cam", "cam", ports(port("irq", "O", ("concat", "In0"), kind="INTERRUPT"))),
            module("dma", "axi_dma", ports(port("s2mm_introut", "O", ("concat", "In1"), kind="INTERRUPT"))),
            *more,
        )
    )


def test_design_and_modules_are_read() -> None:
    found = handoff.parse(hwh(module("gpio", "axi_gpio", parameters={"C_IS_DUAL": "1"}), design="camera"))
    assert (found.design, found.device, found.vivado) == ("camera", "7z020", "2022.1")
    assert found.modules["gpio"].type == "axi_gpio"
    assert found.modules["gpio"].parameters == {"C_IS_DUAL": "1"}


def test_registers_and_fields_are_read() -> None:
    text = described(
        register(
            "CTRL", 0, register_field("AP_START", 0, 1), register_field("AP_DONE", 1, 1, "read-only"), RESET_VALUE="4"
        )
    )
    (found,) = handoff.parse(hwh(module("acc", "acc", text))).modules["acc"].registers["S_AXI"]
    assert (found.name, found.offset, found.size, found.access, found.reset) == ("CTRL", 0, 32, "read-write", 4)
    assert [(field.name, field.lsb, field.width, field.access) for field in found.fields] == [
        ("AP_START", 0, 1, "read-write"),
        ("AP_DONE", 1, 1, "read-only"),
    ]


def test_register_that_is_switched_off_is_left_out() -> None:
    text = described(register("A", 0), register("B", 4, IS_ENABLED="false"))
    found = handoff.parse(hwh(module("acc", "acc", text))).modules["acc"].registers["S_AXI"]
    assert [item.name for item in found] == ["A"]


def test_windows_are_those_of_the_processor() -> None:
    ranges = memory(("gpio", 0x41200000, 0x10000), ("gpio", 0x41200000, 0x10000), ("acc", 0x40000000, 0x1000))
    own = memory_range("ps", 0, 0x20000000, kind="MEMORY")
    found = handoff.parse(hwh(module("ps", PS, ranges.replace("</MEMORYMAP>", own + "</MEMORYMAP>"))))
    assert [(item.instance, item.base, item.size) for item in handoff.windows(found)] == [
        ("acc", 0x40000000, 0x1000),
        ("gpio", 0x41200000, 0x10000),
    ]


def test_windows_of_a_partial_are_relative() -> None:
    text = f'<BUSINTERFACE NAME="S_AXI"><MEMORYMAP>{memory_range("gpio", 0, 0x1000)}</MEMORYMAP></BUSINTERFACE>'
    found = handoff.parse(hwh(module("gpio", "axi_gpio"), external=text))
    assert [(item.instance, item.base) for item in handoff.windows(found)] == [("gpio", 0)]


def test_interrupts_are_traced_through_concatenation_and_controller() -> None:
    lines = handoff.interrupts(interrupt_design())
    assert [(line.instance, line.port, line.controller, line.index) for line in lines] == [
        ("cam", "irq", "intc", 0),
        ("dma", "s2mm_introut", "intc", 1),
    ]


def test_unconnected_concatenation_input_keeps_its_place() -> None:
    found = handoff.parse(
        hwh(
            module("ps", PS, ports(port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=4))),
            module("concat", "xlconcat", ports(port("In0", "I", bits=3), port("In1", "I", ("cam", "irq")))),
            module("cam", "cam"),
        )
    )
    assert [(line.instance, line.controller, line.index) for line in handoff.interrupts(found)] == [("cam", None, 3)]


def test_concatenations_in_a_ring_end() -> None:
    found = handoff.parse(
        hwh(
            module("ps", PS, ports(port("IRQ_F2P", "I", ("a", "dout"), kind="INTERRUPT"))),
            module("a", "xlconcat", ports(port("In0", "I", ("b", "dout")), port("In1", "I", ("b", "dout")))),
            module("b", "xlconcat", ports(port("In0", "I", ("a", "dout")), port("In1", "I", ("a", "dout")))),
        )
    )
    assert handoff.interrupts(found) == ()


def test_dma_channels_are_those_that_are_switched_on() -> None:
    parameters = {"C_INCLUDE_MM2S": "0", "C_S_AXIS_S2MM_TDATA_WIDTH": "64"}
    found = handoff.parse(
        hwh(module("ps", PS, memory(("dma", 0x40400000, 0x10000))), module("dma", "axi_dma", parameters=parameters))
    )
    (channel,) = handoff.dma_channels(found)
    assert (channel.instance, channel.direction, channel.base, channel.width) == ("dma", "s2mm", 0x40400000, 64)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, (True, 14)),
        ({"C_INCLUDE_SG": "1", "C_SG_LENGTH_WIDTH": "26"}, (True, 26)),
        ({"c_include_sg": "0", "c_sg_length_width": "16"}, (False, 16)),
    ],
)
def test_scatter_gather_and_the_length_register_are_read_as_the_core_or_its_customisation_has_them(
    parameters: dict[str, str], expected: tuple[bool, int]
) -> None:
    found = handoff.parse(hwh(module("dma", "axi_dma", parameters=parameters)))
    assert {(c.scatter_gather, c.length_bits) for c in handoff.dma_channels(found)} == {expected}


def decoupled_by(driver: str, output: str, *more: str) -> Hwh:
    return handoff.parse(
        hwh(
            module("ps", PS, memory(("gpio", 0x41200000, 0x1000))),
            module(
                "dec",
                "dfx_decoupler",
                ports(port("decouple", "I", ("slice", "Dout")), port("rp_x", "I", ("pr_0", "x"))),
            ),
            module(
                "slice",
                "xlslice",
                ports(port("Din", "I", (driver, output))),
                parameters={"DIN_FROM": "3", "DIN_TO": "3"},
            ),
            module("gpio", "axi_gpio"),
            module("pr_0", "rm", region=True),
            *more,
        )
    )


@pytest.mark.parametrize(
    ("driver", "output", "expected"),
    [
        ("gpio", "gpio2_io_o", (0x41200000, 8, 3, "", 0)),
        ("ps", "GPIO_O", (None, 0, 0, "zynq_gpio", 57)),
        ("ps", "SPI0_SS_O", (None, 0, 0, "", 0)),  # another pin of the processor: no register, no line
    ],
)
def test_decoupler_is_followed_to_the_bit_or_line_that_drives_it(
    driver: str, output: str, expected: tuple[object, ...]
) -> None:
    (found,) = handoff.decouplers(decoupled_by(driver, output))
    assert (found.base, found.offset, found.bit, found.chip, found.line) == expected
    assert found.driver == driver
    assert "pr_0" in found.neighbours


def test_decoupler_with_its_own_register_is_bit_zero_of_it() -> None:
    ps = module("ps", PS, memory(("dec", 0x43C00000, 0x1000)))
    (found,) = handoff.decouplers(handoff.parse(hwh(ps, module("dec", "dfx_decoupler"))))
    assert (found.driver, found.base, found.offset, found.bit) == ("dec", 0x43C00000, 0, 0)


def test_clocks_are_those_that_are_switched_on() -> None:
    parameters = {
        "PCW_FPGA_FCLK0_ENABLE": "1",
        "PCW_ACT_FPGA0_PERIPHERAL_FREQMHZ": "142.857132",
        "PCW_FPGA_FCLK1_ENABLE": "0",
        "PCW_ACT_FPGA1_PERIPHERAL_FREQMHZ": "10.0",
    }
    found = handoff.clocks(handoff.parse(hwh(module("ps", PS, parameters=parameters))))
    assert [(clock.name, clock.rate) for clock in found] == [("fclk0", 142857132)]


def test_registers_of_common_ip_are_known_without_description() -> None:
    single = handoff.parse(hwh(module("g", "axi_gpio"))).modules["g"]
    dual = handoff.parse(hwh(module("g", "axi_gpio", parameters={"C_IS_DUAL": "1"}))).modules["g"]
    assert [item.name for item in handoff.registers(single, "S_AXI")][:2] == ["GPIO_DATA", "GPIO_TRI"]
    assert "GPIO2_DATA" in [item.name for item in handoff.registers(dual, "S_AXI")]
    assert handoff.registers(handoff.parse(hwh(module("x", "other"))).modules["x"], "S_AXI") == ()


def test_connections_are_read() -> None:
    found = handoff.parse(hwh(module("a", "a", ports(port("o", "O", ("b", "i"), ("c", "i"), bits=8)))))
    assert found.modules["a"].ports["o"].connections == (ConnectedPort("b", "i"), ConnectedPort("c", "i"))
    assert found.modules["a"].ports["o"].width == 8


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"not xml", "not XML"),
        ("<EDKSYSTEM/>".encode("utf-16"), "no UTF-8 text"),
        (b"<EDKSYSTEM/>", "no hardware handoff"),
        (b"<html><SYSTEMINFO/></html>", "found html"),
        (b'<!DOCTYPE x [<!ENTITY a "b">]><EDKSYSTEM><SYSTEMINFO/></EDKSYSTEM>', "document type"),
        (hwh(module("ps", PS, memory(("x", 0, 16)).replace("0x00000000", "zero"))), "'zero' is not a number"),
    ],
)
def test_what_is_not_a_handoff_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(HwhError, match=reason):
        handoff.parse(data)


def test_refusal_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "top.hwh"
    path.write_bytes(b"")
    with pytest.raises(HwhError, match=r"top\.hwh"):
        handoff.read(path)


@pytest.mark.parametrize("encoding", ["aTF-8", "shift_jis", ""])
def test_an_encoding_that_xml_is_not_read_in_is_refused(encoding: str) -> None:
    with pytest.raises(HwhError, match="not XML"):
        handoff.parse(f'<?xml version="1.0" encoding="{encoding}"?><EDKSYSTEM/>'.encode())


@given(st.binary(max_size=60), st.integers(0, 2000))
def test_any_damage_is_read_or_refused(noise: bytes, where: int) -> None:
    data = hwh(module("ps", PS, memory(("gpio", 0, 4096))), module("gpio", "axi_gpio", described(register("A", 0))))
    at = where % len(data)
    try:
        found = handoff.parse(data[:at] + noise + data[at + len(noise) :])
    except HwhError:
        return
    for question in (handoff.windows, handoff.interrupts, handoff.dma_channels, handoff.decouplers, handoff.clocks):
        question(found)  # type: ignore[operator]


def test_rate_of_a_clock_may_be_a_decimal_number() -> None:
    """Vivado 2022.2 writes computed frequencies that way."""
    pin = port("CLK", "I", kind="clk").replace("<PORT ", '<PORT CLKFREQUENCY="93750000.0" ')
    assert handoff.parse(hwh(module("a", "a", ports(pin)))).modules["a"].ports["CLK"].rate == 93_750_000
    with pytest.raises(HwhError, match="port CLK: CLKFREQUENCY '93 MHz' is not a number"):
        handoff.parse(hwh(module("a", "a", ports(pin.replace("93750000.0", "93 MHz")))))

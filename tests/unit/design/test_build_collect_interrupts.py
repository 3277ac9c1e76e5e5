# SPDX-License-Identifier: Apache-2.0
"""Interrupts of a foreign design: those that an overlay can give to a UIO device are in both schema and overlay."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest
from import_support import bitstream, described, hwh, memory, module, port, ports, register

from cm.design.collect.collection import collect
from cm.design.collect.foreign_dma import interrupts
from cm.design.platforms import ZYNQ7000
from cm.formats import hwh as handoff
from cm.formats.hwh import HwhError

IRQ = port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=4)
FIQ = port("Core0_nFIQ", "I", ("cam", "fiq"), kind="INTERRUPT")


def design(*lines: tuple[str, str], pins: str = IRQ, more: tuple[str, ...] = ()) -> bytes:
    """Two instances with windows and a DMA engine; `lines` go to the processor's interrupts in that order."""
    windows = memory(("cam", 0x43C00000, 0x10000), ("tx", 0x43C10000, 0x10000), ("dma", 0x40400000, 0x10000))
    return hwh(
        module("ps", "processing_system7", windows, ports(pins)),
        module("concat", "xlconcat", ports(*(port(f"In{index}", "I", line) for index, line in enumerate(lines)))),
        module("cam", "cam", described(register("CTRL", 0))),
        module("tx", "tx"),
        module("dma", "axi_dma", described(register("MM2S_DMACR", 0))),
        *more,
    )


def test_of_several_lines_of_an_instance_the_first_is_reported_and_the_others_are_noted() -> None:
    lines = (("tx", "irq0"), ("tx", "irq1"), ("cam", "done"), ("dma", "mm2s_introut"))
    found = interrupts(handoff.parse(design(*lines)), ZYNQ7000)
    assert {name: line.base_address for name, line in found.lines.items()} == {
        "tx_irq0": 0x43C10000,
        "cam_done": 0x43C00000,
    }
    assert found.spis == {"tx": 29, "cam": 31}
    (note,) = found.notes
    assert note.startswith("interrupt irq1 of tx is not its first")


def test_a_line_that_no_overlay_can_give_is_noted_and_the_next_one_taken() -> None:
    """A private interrupt of a core comes first in the processor's ports; the shared one is the UIO device's."""
    found = interrupts(handoff.parse(design(("cam", "irq"), pins=FIQ + IRQ)), ZYNQ7000)
    assert (found.lines["cam_irq"].base_address, found.spis) == (0x43C00000, {"cam": 29})
    assert found.notes[0].startswith("interrupt fiq of cam goes to Core0_nFIQ")


def test_a_line_behind_an_interrupt_controller_is_noted() -> None:
    intc = module("intc", "axi_intc", ports(port("intr", "I", ("cam", "irq")), port("irq", "O")))
    found = interrupts(handoff.parse(design(("intc", "irq"), more=(intc,))), ZYNQ7000)
    assert (found.lines, found.spis) == ({}, {})
    assert found.notes[0].startswith("interrupt irq of cam goes to intc: no overlay can give that")


def test_collected_schema_and_overlay_agree_and_leave_engines_to_their_driver(tmp_path: Path) -> None:
    (tmp_path / "top.hwh").write_bytes(design(("tx", "irq0"), ("tx", "irq1"), ("dma", "mm2s_introut")))
    (tmp_path / "top.bit").write_bytes(bitstream(None))
    found = collect([tmp_path])
    assert set(found.config.interrupts) == {"tx_irq0"}
    assert set(found.config.registers) == {"cam_ctrl"}
    assert any("irq1 of tx" in note for note in found.notes)


def test_a_description_in_an_archive_is_called_by_the_archive(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "system.xsa", "w") as archive:
        archive.writestr("top.hwh", b"<html/>")
    with pytest.raises(HwhError, match="^" + re.escape(f"{tmp_path}/system.xsa: top.hwh: no hardware handoff")):
        collect([tmp_path / "system.xsa"])

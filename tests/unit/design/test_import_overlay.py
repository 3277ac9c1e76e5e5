# SPDX-License-Identifier: Apache-2.0
"""The overlay of a PYNQ package that has none."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from import_support import bitstream, hwh, memory, module, port, ports

from cm.cli.main import main
from cm.formats import fdt
from cm.schema import load
from cm.schema.named_files import overlay_path


def test_an_overlay_that_the_package_lacks_is_made_in_the_same_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if shutil.which("dtc") is None:
        pytest.skip("needs dtc")
    bit, out = tmp_path / "cam.bit", tmp_path / "out"
    bit.write_bytes(bitstream())
    windows = memory(("gpio", 0x41200000, 0x10000), ("dma", 0x40400000, 0x10000))
    line = ports(port("IRQ_F2P", "I", ("dma", "mm2s_introut"), kind="INTERRUPT"))
    blocks = (module("gpio", "axi_gpio"), module("dma", "axi_dma"))
    (tmp_path / "cam.hwh").write_bytes(hwh(module("ps", "processing_system7", windows, line), *blocks))
    assert main(["import", "pynq", str(bit), "--out", str(out)]) == 0
    assert "note: cam.dtbo: made of the .hwh, since the package has none" in capsys.readouterr().out
    config = load(out / "cam.yaml")
    assert overlay_path(config, config.overlays[0]) == out / "cam.dtbo"
    nodes = {node.name for _, node in fdt.unpack((out / "cam.dtbo").read_bytes()).walk()}
    assert {"gpio@41200000", "dma@40400000"} & nodes
    assert b"dma_mm2s" in (out / "cam.dtbo").read_bytes()


def test_an_interrupt_that_rises_is_described_as_an_edge(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if shutil.which("dtc") is None:
        pytest.skip("needs dtc")
    (tmp_path / "cam.bit").write_bytes(bitstream())
    ends = {"level": "LEVEL_HIGH", "edge": "EDGE_RISING"}
    sources = [
        module(name, name, ports(port("irq", "O", ("concat", "dout"), kind="INTERRUPT", sensitivity=kind)))
        for name, kind in ends.items()
    ]
    inputs = [port(f"In{at}", "I", (name, "irq")) for at, name in enumerate(ends)]
    windows = memory(("level", 0x43C00000, 0x1000), ("edge", 0x43C10000, 0x1000))
    line = ports(port("IRQ_F2P", "I", ("concat", "dout"), kind="INTERRUPT", bits=2))
    concat = module("concat", "xlconcat", ports(port("dout", "O", bits=2), *inputs))
    design = hwh(module("ps", "processing_system7", windows, line), concat, *sources)
    (tmp_path / "cam.hwh").write_bytes(design)
    assert main(["import", "pynq", str(tmp_path / "cam.bit"), "--out", str(tmp_path / "out")]) == 0
    nodes = {node.name: node for _, node in fdt.unpack((tmp_path / "out/cam.dtbo").read_bytes()).walk()}
    lines = {name: nodes[name].properties["interrupts"] for name in ("level@43c00000", "edge@43c10000")}
    assert [line[-1] for line in lines.values()] == [4, 1]
    told = capsys.readouterr().out
    assert "irq of level: its status is not described" in told
    assert "irq of edge" not in told

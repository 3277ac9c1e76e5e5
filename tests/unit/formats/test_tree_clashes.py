# SPDX-License-Identifier: Apache-2.0
"""Overlays on a board's tree: applied as libfdt applies them, and what they and the tree both ask for."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from build_support import needs

from cm.formats import fdt
from cm.formats.fdt import FdtError, FdtNode
from cm.formats.fdt_overlay import apply
from cm.formats.tree_clashes import Clash, clashes

pytestmark = [pytest.mark.design, needs("dtc")]

# a Zynq in a few nodes, as a stock image describes it: a window and an interrupt of the PL for UIO
BASE = """/dts-v1/;
/ {
    #address-cells = <1>; #size-cells = <1>;
    fabric@40000000 {
        compatible = "generic-uio"; reg = <0x40000000 0x10000>; interrupt-parent = <&intc>; interrupts = <0 29 4>;
    };
    axi {
        #address-cells = <1>; #size-cells = <1>; compatible = "simple-bus"; ranges = <0x0 0x80000000 0x40000000>;
        intc: interrupt-controller@1000 { interrupt-controller; #interrupt-cells = <3>; reg = <0x1000 0x1000>; };
        clkc: clock@2000 { #clock-cells = <1>; clock-output-names = "armpll", "fclk0"; reg = <0x2000 0x100>; };
        engine@4000 {
            compatible = "xlnx,axi-dma-1.00.a"; reg = <0x4000 0x1000>;
            interrupt-parent = <&intc>; interrupts = <0 30 4>;
        };
    };
};
"""
OVERLAY = """/dts-v1/;
/plugin/;
&{/} {
    control@40010000 {
        compatible = "fpga-cm,window", "fpga-cm,uio", "generic-uio"; reg = <0x40010000 0x1000>;
        interrupt-parent = <&intc>; interrupts = <0 31 4>; clocks = <&clkc 1>;
    };
    dma: dma@44000000 {
        compatible = "xlnx,axi-dma-1.00.a"; reg = <0x44000000 0x1000>;
        channel@44000000 {
            compatible = "xlnx,axi-dma-mm2s-channel"; interrupt-parent = <&intc>; interrupts = <0 32 4>;
        };
    };
    client { compatible = "fpga-cm,dma-client"; dmas = <&dma 0>; };
};
"""
Edit = tuple[str, str]


def compiled(folder: Path, text: str, name: str, symbols: str = "-@") -> FdtNode:
    (folder / f"{name}.dts").write_text(text)
    flags = ["-q", "-q", *([symbols] if symbols else [])]
    command = ["dtc", *flags, "-I", "dts", "-O", "dtb", "-o", folder / f"{name}.dtb", folder / f"{name}.dts"]
    subprocess.run(command, check=True)
    return fdt.unpack((folder / f"{name}.dtb").read_bytes())


@pytest.fixture
def found(tmp_path: Path) -> Callable[..., list[Clash]]:
    def find(
        base: Edit = ("", ""), overlay: Edit = ("", ""), symbols: str = "-@", idle: tuple[str, ...] = ()
    ) -> list[Clash]:
        tree = compiled(tmp_path, BASE.replace(*base), "base", symbols)
        return clashes(tree, {"ours": compiled(tmp_path, OVERLAY.replace(*overlay), "ours")}, idle)

    return find


def test_what_nothing_else_asks_for_is_no_clash(found: Callable[..., list[Clash]]) -> None:
    assert found() == []


@pytest.mark.parametrize(
    ("overlay", "base", "kind", "node", "holder"),
    [
        (("<0 31 4>", "<0 29 4>"), ("", ""), "irq", "/control@40010000", "/fabric@40000000"),
        (("<0 31 4>", "<0 29 1>"), ("", ""), "irq", "/control@40010000", "/fabric@40000000"),
        (("<0 31 4>", "<0 30 4>"), ("", ""), "irq", "/control@40010000", "/axi/engine@4000"),
        (("0x44000000 0x1000", "0x80004800 0x1000"), ("", ""), "window", "/dma@44000000", "/axi/engine@4000"),
        (("<&clkc 1>", "<&clkc 2>"), ("", ""), "clock", "/control@40010000", ""),
        (("", ""), ("clkc: clock@2000 {", 'clkc: clock@2000 { status = "disabled";'), "clock", "/control@40010000", ""),
        (("&clkc 1", "&other 1"), ("", ""), "label", "ours", ""),
    ],
)
def test_each_kind_of_clash_names_both_nodes(
    found: Callable[..., list[Clash]], overlay: Edit, base: Edit, kind: str, node: str, holder: str
) -> None:
    (one,) = found(base, overlay)
    assert (one.kind, one.node, one.holder) == (kind, node, holder)
    assert node in one.text
    assert holder in one.text
    assert one.advice


@pytest.mark.parametrize(
    ("overlay", "base"),
    [
        (("<0 31 4>", "<0 29 4>"), ('compatible = "generic-uio"; reg', 'status = "disabled"; reg')),
        (("<0 32 4>", "<0 30 4>"), ("", "")),  # xilinx_dma shares its interrupts
        (("0x40010000 0x1000", "0x40000000 0x1000"), ("", "")),  # UIO only maps
        (("0x44000000 0x1000", "0x4000 0x1000"), ("", "")),  # the bus shows the engine at 0x80004000
    ],
)
def test_what_drivers_share_or_only_map_is_no_clash(
    found: Callable[..., list[Clash]], overlay: Edit, base: Edit
) -> None:
    assert found(base, overlay) == []


def test_a_node_without_a_driver_holds_nothing(found: Callable[..., list[Clash]]) -> None:
    assert found(overlay=("<0 31 4>", "<0 29 4>"), idle=("/fabric@40000000",)) == []


def test_the_holder_of_generic_uio_is_freed_by_the_command_that_is_said(found: Callable[..., list[Clash]]) -> None:
    (one,) = found(overlay=("<0 31 4>", "<0 29 4>"))
    assert "echo 40000000.fabric >/sys/bus/platform/drivers/uio_pdrv_genirq/unbind" in one.advice


def test_a_tree_without_symbols_is_named_before_the_kernel_refuses(found: Callable[..., list[Clash]]) -> None:
    (one,) = found(symbols="")
    assert one.kind == "label"
    assert "no __symbols__" in one.text
    assert "dtc -@" in one.advice


@needs("fdtoverlay")
def test_an_overlay_is_applied_as_libfdt_applies_it(tmp_path: Path) -> None:
    base, ours = compiled(tmp_path, BASE, "base"), compiled(tmp_path, OVERLAY, "ours")
    files = [tmp_path / name for name in ("base.dtb", "merged.dtb", "ours.dtb")]
    subprocess.run(["fdtoverlay", "-i", files[0], "-o", files[1], files[2]], check=True)
    theirs = {path: node.properties for path, node in fdt.unpack(files[1].read_bytes()).walk()}
    mine = {path: node.properties for path, node in apply(base, ours).root.walk()}
    assert mine == theirs


def test_a_later_overlay_may_name_the_labels_of_an_earlier_one(tmp_path: Path) -> None:
    base, ours = compiled(tmp_path, BASE, "base"), compiled(tmp_path, OVERLAY, "ours")
    second = compiled(tmp_path, "/dts-v1/; /plugin/; &dma { more; };", "second")
    assert clashes(base, {"ours": ours, "second": second}) == []
    with pytest.raises(FdtError, match="no label dma"):
        apply(base, second)


def test_the_live_tree_is_read_as_it_was_built(tmp_path: Path) -> None:
    tree = compiled(tmp_path, BASE, "base")
    for path, node in tree.walk():
        folder = tmp_path / "live" / path.lstrip("/")
        folder.mkdir()
        for name, value in node.properties.items():
            (folder / name).write_bytes(value)
    live = {path: node.properties for path, node in fdt.read_folder(tmp_path / "live").walk()}
    assert live == {path: node.properties for path, node in tree.walk()}

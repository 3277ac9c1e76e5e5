# SPDX-License-Identifier: Apache-2.0
"""`cm doctor` on /proc and /sys as boards have them: it names each obstacle to a first frame, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from cm.cli.main import main
from cm.device.check_result import Finding, State
from cm.device.survey import survey
from cm.formats import fdt

ZYNQ_LABELS = ("intc", "clkc", "devcfg", "fpga_full", "amba")
ZYNQMP_LABELS = ("gic", "zynqmp_clk", "zynqmp_pcap", "fpga_full", "amba")


@dataclass
class Tree:
    """A root folder that is filled file by file."""

    root: Path

    def put(self, path: str, content: str | bytes = "") -> Tree:
        place = self.root / path
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content.encode() if isinstance(content, str) else content)
        return self

    def device(self, name: str, *compatible: str, driver: str = "", **properties: bytes) -> Tree:
        """A platform device with its node; in a property's name, two underscores mean a dash, and one a comma."""
        place = f"sys/bus/platform/devices/{name}"
        self.put(f"{place}/of_node/compatible", "\0".join(compatible) + "\0")
        for key, value in properties.items():
            self.put(f"{place}/of_node/{key.replace('__', '-').replace('_', ',', 1)}", value)
        if driver:
            (self.root / place / "driver").symlink_to(f"../../../bus/platform/drivers/{driver}")
        return self

    def symbols(self, *labels: str) -> Tree:
        for label in labels:
            self.put(f"proc/device-tree/__symbols__/{label}", "/x\0")
        return self

    def process(self, pid: int, comm: str) -> Tree:
        return self.put(f"proc/{pid}/comm", f"{comm}\n")

    def found(self, kind: str) -> tuple[Finding, ...]:
        return survey(self.root).of(kind)

    def one(self, kind: str) -> Finding:
        (found,) = self.found(kind)
        return found


def board(root: Path, model: str, *compatible: str, release: str, cma: int, command_line: str) -> Tree:
    tree = Tree(root)
    tree.put("proc/device-tree/model", f"{model}\0").put("proc/device-tree/compatible", "\0".join(compatible) + "\0")
    tree.put("proc/sys/kernel/osrelease", f"{release}\n").put("proc/cmdline", command_line + "\n")
    tree.put("proc/meminfo", f"MemTotal: 500000 kB\nCmaTotal:  {cma} kB\nCmaFree:   {cma - 1024} kB\n")
    return tree.put("proc/modules").process(1, "systemd")


@pytest.fixture
def pynq(tmp_path: Path) -> Tree:
    """A PYNQ-Z2 with PYNQ 3: UIO is built in, the kernel's command line names generic-uio, PYNQ's server runs."""
    tree = board(
        tmp_path, "TUL PYNQ-Z2 board", "tul,pynq-z2", "xlnx,zynq-7000", release="5.15.19-xilinx-v2022.1",
        cma=131072, command_line="root=/dev/mmcblk0p2 rw uio_pdrv_genirq.of_id=generic-uio",
    )  # fmt: skip
    tree.put("sys/module/uio_pdrv_genirq/uevent")
    tree.put("lib/modules/5.15.19-xilinx-v2022.1/modules.builtin", "kernel/drivers/uio/uio_pdrv_genirq.ko\n")
    return tree.symbols(*ZYNQ_LABELS).process(812, "start_pl_server")


@pytest.fixture
def kria(tmp_path: Path) -> Tree:
    """A KV260 with Ubuntu: UIO is a module, dfx-mgr runs with an application of its own loaded."""
    tree = board(
        tmp_path, "ZynqMP KV260 revB", "xlnx,zynqmp-sk-kv260-revB", "xlnx,zynqmp-sk-kv260", "xlnx,zynqmp",
        release="5.15.0-1027-xilinx-zynqmp", cma=1024000, command_line="console=ttyPS1 cma=1000M",
    )  # fmt: skip
    tree.put("proc/modules", "uio_pdrv_genirq 16384 0 - Live 0x0\nzocl 1 0 - Live 0x0\n")
    return tree.symbols(*ZYNQMP_LABELS).process(900, "dfx-mgrd")


@pytest.fixture
def petalinux(tmp_path: Path) -> Tree:
    """A ZCU104 with PetaLinux from an XSA: no symbols, the PL stands in the board's tree, 16 MiB of CMA."""
    tree = board(
        tmp_path, "ZynqMP ZCU104 RevC", "xlnx,zynqmp-zcu104-revC", "xlnx,zynqmp",
        release="6.6.10-xilinx-v2024.1", cma=16384, command_line="console=ttyPS0",
    )  # fmt: skip
    bits = (26).to_bytes(4, "big")
    tree.device("a0000000.dma", "xlnx,axi-dma-1.00.a", driver="xilinx-vdma", xlnx_sg__length__width=bits)
    return tree.device("a0000000.dma-controller", "xlnx,axi-dma-1.00.a", xlnx_sg__length__width=bits)


def test_nothing_is_checked_on_a_machine_that_is_not_a_zynq(tmp_path: Path) -> None:
    tree = Tree(tmp_path).put("proc/device-tree/compatible", "raspberrypi,4-model-b\0brcm,bcm2711\0")
    kinds = {finding.kind for finding in survey(tree.root).findings}
    assert kinds == {"uio", "dma", "icap", "overlays", "fpga_manager"}


def test_the_board_and_its_kernel_are_named(pynq: Tree) -> None:
    assert pynq.one("board").detail == "TUL PYNQ-Z2 board (zynq), Linux 5.15.19-xilinx-v2022.1"


# ---- what is found, by kind of check ---------------------------------------------

UIO_BUILT_IN = "lib/modules/5.15.19-xilinx-v2022.1/modules.builtin"
ZONES = """\
Node 0, zone   Normal
  pages free     100
        cma      0
Node 0, zone  HighMem
  pages free     100
        cma      32768
"""
UIO_MISSING = "lib/modules/6.6.10-xilinx-v2024.1/modules.dep"
Change = Callable[[Tree], object]


def gone(path: str) -> Change:
    return lambda tree: (tree.root / path).unlink()


def file(path: str, content: str = "") -> Change:
    return lambda tree: tree.put(path, content)


def node(name: str, *compatible: str, driver: str = "", **properties: bytes) -> Change:
    return lambda tree: tree.device(name, *compatible, driver=driver, **properties)


OK, MISSING, WRONG = State.OK, State.MISSING, State.WRONG
APPLIED = "sys/kernel/config/device-tree/overlays"
IN_6_6 = "lib/modules/5.15.19-xilinx-v2022.1/modules.dep"


@pytest.mark.parametrize(
    ("machine", "changes", "kind", "state", "says"),
    [
        # the kernel
        ("petalinux", [], "symbols", MISSING, ["dtc -@"]),
        ("kria", [], "symbols", OK, []),
        ("kria", [gone("proc/device-tree/__symbols__/zynqmp_pcap")], "symbols", WRONG, ["no label zynqmp_pcap"]),
        ("pynq", [], "of_id", OK, ["built in, of_id=generic-uio"]),
        ("pynq", [file("proc/cmdline", "root=/dev/mmcblk0p2 rw\n")], "of_id", WRONG,
            ["built in, of_id=not set", "uio_pdrv_genirq.of_id=fpga-cm,uio on the kernel's command line"]),
        ("pynq", [  # options of modprobe do not reach a driver that is built in
            file("proc/cmdline", "rw\n"),
            file("etc/modprobe.d/cm.conf", "options uio_pdrv_genirq of_id=fpga-cm,uio\n"),
        ], "of_id", WRONG, []),
        ("kria", [], "of_id", WRONG, []),
        ("kria", [file("etc/modprobe.d/cm.conf", "# ours\noptions uio_pdrv_genirq of_id=fpga-cm,uio\n")], "of_id", OK,
            ["module, of_id=fpga-cm,uio"]),
        ("kria", [file("etc/modprobe.d/other.conf", "options uio_pdrv_genirq of_id=acme,uio\n")], "of_id", WRONG,
            ["module, of_id=acme,uio"]),
        ("petalinux", [], "of_id", MISSING, ["modprobe uio_pdrv_genirq of_id="]),
        ("petalinux", [file(UIO_MISSING, "updates/dkms/cm_window.ko:\n")], "of_id", MISSING,
            ["not in this kernel", "modprobe cm_window"]),
        ("petalinux", [
            file(UIO_MISSING, "updates/dkms/cm_window.ko:\n"), file("proc/modules", "cm_window 1 0 - Live 0x0\n"),
        ], "of_id", OK, []),
        ("pynq", [file("proc/cmdline", 'rw uio_pdrv_genirq.of_id="generic-uio"\n')], "of_id", OK,  # as PYNQ writes it
            ["built in, of_id=generic-uio"]),
        ("pynq", [file("proc/modules", "cm_window 1 0 - Live 0x0\n")], "of_id", WRONG,
            ["takes the windows first: none is lent", "driver_override"]),
        ("pynq", [file("proc/modules", "cm_window 1 0 - Live 0x0\n"),
            file("proc/cmdline", "uio_pdrv_genirq.of_id=none\n")], "of_id", OK, ["cm_window serves"]),
        ("kria", [file("proc/cmdline", "uio_pdrv_genirq.of_id=acme\n"),
            file("etc/modprobe.d/cm.conf", "options uio_pdrv_genirq of_id=fpga-cm,uio\n")], "of_id", WRONG,
            ["module, of_id=acme", "modprobe.d has no effect"]),
        ("pynq", [file("sys/module/firmware_class/parameters/path", "/srv/fw\n\n")], "firmware", WRONG,
            ["printf %s /srv/fw >/sys/module/firmware_class/parameters/path"]),
        ("pynq", [file("proc/meminfo", "CmaTotal: 16384 kB\nCmaFree: 4096 kB\n")], "cma", WRONG, []),
        ("pynq", [], "cma", OK, ["128 MiB, 127 free"]),
        ("pynq", [file("proc/zoneinfo", ZONES)], "cma", OK, ["127 free, in high memory: buffers are uncached"]),
        ("pynq", [file("proc/meminfo", "MemTotal: 500000 kB\n")], "cma", MISSING, ["CONFIG_DMA_CMA"]),
        ("kria", [node("a0000014.icap", "fpga-cm,icap-loader")], "pmufw", WRONG,
            ["0xFFCA3008 in its pm_mmio_access.c", "loader: auto"]),
        # nodes
        *(
            ("pynq", [gone(UIO_BUILT_IN), node("node", compatible)], "unbound", WRONG, [f" modprobe {module}"])
            for compatible, module in (
                ("fpga-cm,dma-client", "cm_dma"), ("fpga-cm,decoupler", "xilinx_pr_decoupler"),
                ("fpga-cm,clocks", "cm_clock"), ("xlnx,pr-decoupler", "xilinx_pr_decoupler"),
                ("fpga-cm,polled-intc", "cm_intc"), ("xlnx,xps-intc-1.00.a", "cm_intc"),
                ("fpga-cm,uio", "uio_pdrv_genirq"),
            )
        ),
        *(
            ("pynq", [gone(UIO_BUILT_IN), file(IN_6_6, modules), node("node", compatible)], "unbound", WRONG, says)
            for compatible, modules, says in (
                ("xlnx,pr-decoupler", "updates/dkms/cm_dma.ko:\n",
                    ["xilinx_pr_decoupler is not in this kernel", "CONFIG_XILINX_PR_DECOUPLER"]),
                ("fpga-cm,window", "updates/dkms/cm_dma.ko:\n",
                    ["cm_window is not built for this kernel", "fpga-cm-dkms"]),
                ("xlnx,pr-decoupler", "kernel/xilinx-pr-decoupler.ko:\n", [" modprobe "]),
                ("fpga-cm,window", "kernel/cm-window.ko:\n", [" modprobe "]),
            )
        ),
        ("pynq", [node("40000000.control", "fpga-cm,uio", "generic-uio")], "unbound", WRONG,
            ["dmesg | grep 40000000.control", "of_id"]),
        ("petalinux", [], "twice", WRONG, ["a0000000.dma and a0000000.dma-controller", "Remove PL from device tree"]),
        ("pynq", [node("40400000.dma", "xlnx,axi-dma-1.00.a", driver="xilinx-vdma")], "engine", WRONG, ["14 bits"]),
        ("pynq", [node("b0000000.dma", "xlnx,axi-vdma-1.00.a", driver="xilinx-vdma", dma__coherent=b"")], "engine", OK,
            ["coherent"]),
        ("pynq", [
            file("sys/class/cm_dma/cm_dma!camera/caps", "residue simple\n"),
            file("sys/class/cm_dma/cm_dma!camera/max_length", "16383\n"),
        ], "channel", WRONG, ["residue simple, at most 16383 bytes", "Enable Scatter Gather Engine"]),
        # ports, clocks, others
        ("kria", [node("cm-afi", "xlnx,afi-fpga")], "afi", WRONG, ["boot loader"]),
        ("kria", [node("cm-afi", "xlnx,afi-fpga", driver="afi-fpga")], "afi", OK, []),
        ("kria", [
            file("sys/class/cm_clock/pl_clk0/rate", "99999001\n"), file("sys/class/cm_clock/pl_clk0/enable", "1\n"),
        ], "clock", OK, ["99.999001 MHz"]),
        ("kria", [], "clock", MISSING, ["modprobe cm_clock"]),
        ("kria", [], "other", WRONG, ["xmutil unloadapp"]),
        ("pynq", [], "other", WRONG, ["disable --now pl_server"]),
        ("petalinux", [lambda tree: tree.process(77, "fpgad")], "other", WRONG, ["snap stop"]),
        ("petalinux", [], "other", OK, []),
        ("petalinux", [file(f"{APPLIED}/kv260-smartcam/dtbo", "firmware-name")], "other", WRONG,
            ["has loaded another design", "xmutil unloadapp"]),
        ("petalinux", [
            file(f"{APPLIED}/whole/dtbo", "firmware-name"), file("lib/firmware/cm/loop/whole.dtbo"),
            file(f"{APPLIED}/cm-prr0/dtbo", "firmware-name"), file(f"{APPLIED}/leds/dtbo", "compatible"),
        ], "other", OK, []),
        ("petalinux", [file("etc/systemd/system/basic.target.wants/bootpy.service")], "other", WRONG,
            ["base.bit", "systemctl disable --now bootpy"]),
        ("petalinux", [file("etc/systemd/system/multi-user.target.wants/clear_pl_statefile.service")], "other", WRONG,
            ["each login of root", "disable --now clear_pl_statefile"]),
        ("petalinux", [file("usr/lib/systemd/system/multi-user.target.wants/dfx-mgr-fw-load.service")], "other", WRONG,
            ["default_firmware", "dfx-mgr-fw-load"]),
    ],
)  # fmt: skip
def test_what_is_found_is_said_with_what_to_do(
    machine: str, changes: list[Change], kind: str, state: State, says: list[str], request: pytest.FixtureRequest
) -> None:
    tree: Tree = request.getfixturevalue(machine)
    for change in changes:
        change(tree)
    found = tree.one(kind)
    assert found.state is state
    assert [words for words in says if words not in f"{found.detail} {found.advice}"] == []


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("pmufw", [node("a0000014.icap", "fpga-cm,icap-loader")]),  # of ZynqMP alone
        ("unbound", [node("40000000.control", "fpga-cm,uio", driver="uio_pdrv_genirq")]),
    ],
)
def test_what_is_in_order_is_no_finding(pynq: Tree, kind: str, changes: list[Change]) -> None:
    for change in changes:
        change(pynq)
    assert pynq.found(kind) == ()


def test_an_engine_says_its_length_register_and_coherence(petalinux: Tree) -> None:
    first, _ = petalinux.found("engine")
    assert first.detail == "length register of 26 bits (67108863 bytes); not coherent: each frame is synchronised"


def test_everything_that_is_wrong_has_advice(petalinux: Tree) -> None:
    assert all(f.advice for f in survey(petalinux.root).findings if f.state is not State.OK)


# ---- overlays and the live tree ------------------------------------------------------


def cells(*numbers: int) -> bytes:
    return b"".join(number.to_bytes(4, "big") for number in numbers)


def control(name: str, spi: int) -> bytes:
    properties = {"compatible": b"fpga-cm,uio\0generic-uio\0", "interrupts": cells(0, spi, 4)}
    properties |= {"interrupt-parent": cells(1), "reg": cells(0x40010000, 0x1000)}
    return fdt.pack(fdt.overlay("/", fdt.FdtNode("", {}, [fdt.FdtNode(name, properties)])))


@pytest.fixture
def stock(pynq: Tree) -> Tree:
    """PYNQ's node `fabric` in the live tree, bound to UIO."""
    live = "proc/device-tree"
    pynq.put(f"{live}/intc/phandle", cells(1)).put(f"{live}/intc/#interrupt-cells", cells(3))
    pynq.put(f"{live}/fabric@40000000/compatible", "generic-uio\0").put(
        f"{live}/fabric@40000000/interrupts", cells(0, 29, 4)
    )
    return pynq.put(f"{live}/fabric@40000000/interrupt-parent", cells(1))


def clash_lines(tree: Tree, capsys: pytest.CaptureFixture[str]) -> list[str]:
    main(["doctor", "--root", str(tree.root), "--runtime-dir", str(tree.root / "none")])
    return [line for line in capsys.readouterr().out.splitlines() if line.startswith("wrong    clash")]


def test_a_configurations_overlay_that_asks_for_what_the_live_tree_gives_to_others_is_named(
    stock: Tree, capsys: pytest.CaptureFixture[str]
) -> None:
    stock.put("lib/firmware/cm/loop/loop_static.dtbo", control("cm-control@40010000", 29))
    (line,) = clash_lines(stock, capsys)
    assert "/cm-control@40010000 asks for what /fabric@40000000 (generic-uio) has" in line


def test_what_one_configuration_brought_is_no_clash_for_another(
    stock: Tree, capsys: pytest.CaptureFixture[str]
) -> None:
    for config in ("loop", "other"):
        stock.put(f"lib/firmware/cm/{config}/{config}_static.dtbo", control(f"{config}@40010000", 31))
    place = "proc/device-tree/loop@40010000"
    stock.put(f"{place}/compatible", "generic-uio\0").put(f"{place}/interrupt-parent", cells(1))
    stock.put(f"{place}/interrupts", cells(0, 31, 4))
    assert clash_lines(stock, capsys) == []


# ---- the report ---------------------------------------------------------------------


def test_the_report_is_a_form_filled_in_as_far_as_possible(
    pynq: Tree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["doctor", "--report", "--root", str(pynq.root), "--runtime-dir", str(tmp_path / "none")])
    text = capsys.readouterr().out
    assert "- board: TUL PYNQ-Z2 board" in text
    assert "- kernel: 5.15.19-xilinx-v2022.1" in text
    assert "- [ ] Board and revision" in text
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert all(line.count(" | ") == 4 for line in rows[1:])
    assert any(line.startswith("| wrong | other | start_pl_server |") for line in rows)

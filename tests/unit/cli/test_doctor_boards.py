# SPDX-License-Identifier: Apache-2.0
"""`cm doctor` on /proc and /sys as boards have them: it names each obstacle to a first frame, and what to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from cm.cli.main import main
from cm.device.finding import Finding, State
from cm.device.survey import survey

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


# ---- the kernel ---------------------------------------------------------------------


def test_a_tree_without_symbols_is_reported_with_what_builds_them(petalinux: Tree) -> None:
    found = petalinux.one("symbols")
    assert found.state is State.MISSING
    assert "dtc -@" in found.advice


def test_a_tree_with_the_labels_that_overlays_name_is_good(kria: Tree) -> None:
    assert kria.one("symbols").state is State.OK


def test_a_label_that_overlays_need_and_the_tree_lacks_is_named(kria: Tree) -> None:
    (kria.root / "proc/device-tree/__symbols__/zynqmp_pcap").unlink()
    found = kria.one("symbols")
    assert (found.state, found.detail) == (State.WRONG, "no label zynqmp_pcap")


def test_uio_that_is_built_in_with_generic_uio_takes_our_nodes(pynq: Tree) -> None:
    found = pynq.one("of_id")
    assert (found.state, found.detail) == (State.OK, "built in, of_id=generic-uio")


def test_uio_that_is_built_in_without_of_id_needs_the_kernels_command_line(pynq: Tree) -> None:
    pynq.put("proc/cmdline", "root=/dev/mmcblk0p2 rw\n")
    found = pynq.one("of_id")
    assert (found.state, found.detail) == (State.WRONG, "built in, of_id=not set")
    assert "uio_pdrv_genirq.of_id=fpga-cm,uio on the kernel's command line" in found.advice


def test_options_of_modprobe_do_not_reach_a_driver_that_is_built_in(pynq: Tree) -> None:
    pynq.put("proc/cmdline", "rw\n").put("etc/modprobe.d/cm.conf", "options uio_pdrv_genirq of_id=fpga-cm,uio\n")
    assert pynq.one("of_id").state is State.WRONG


def test_uio_as_a_module_has_its_of_id_from_modprobe_d(kria: Tree) -> None:
    assert kria.one("of_id").state is State.WRONG
    kria.put("etc/modprobe.d/cm.conf", "# ours\noptions uio_pdrv_genirq of_id=fpga-cm,uio\n")
    assert kria.one("of_id").detail == "module, of_id=fpga-cm,uio"


def test_an_of_id_for_another_device_is_reported(kria: Tree) -> None:
    kria.put("etc/modprobe.d/other.conf", "options uio_pdrv_genirq of_id=acme,uio\n")
    found = kria.one("of_id")
    assert (found.state, found.detail) == (State.WRONG, "module, of_id=acme,uio")


def test_uio_that_is_not_loaded_is_missing(petalinux: Tree) -> None:
    found = petalinux.one("of_id")
    assert found.state is State.MISSING
    assert "modprobe uio_pdrv_genirq of_id=" in found.advice


@pytest.mark.parametrize(("kib", "state"), [(16384, State.WRONG), (131072, State.OK)])
def test_contiguous_memory_below_64_mib_is_reported(pynq: Tree, kib: int, state: State) -> None:
    pynq.put("proc/meminfo", f"CmaTotal: {kib} kB\nCmaFree: 4096 kB\n")
    assert pynq.one("cma").state is state


def test_a_kernel_without_contiguous_memory_is_reported(pynq: Tree) -> None:
    pynq.put("proc/meminfo", "MemTotal: 500000 kB\n")
    found = pynq.one("cma")
    assert found.state is State.MISSING
    assert "CONFIG_DMA_CMA" in found.advice


def test_an_icap_whose_driver_did_not_bind_says_what_the_pmu_firmware_needs(kria: Tree) -> None:
    kria.device("a0000014.icap", "fpga-cm,icap-loader")
    found = kria.one("pmufw")
    assert found.state is State.WRONG
    assert "SECURE_ACCESS" in found.advice
    assert "loader: auto" in found.advice


def test_the_pmu_firmware_does_not_matter_on_zynq_7000(pynq: Tree) -> None:
    assert pynq.found("pmufw") == ()


# ---- nodes --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("compatible", "module"),
    [
        ("fpga-cm,dma-client", "cm_dma"),
        ("fpga-cm,decoupler", "xilinx_pr_decoupler"),
        ("fpga-cm,clocks", "cm_clock"),
        ("xlnx,pr-decoupler", "xilinx_pr_decoupler"),
        ("fpga-cm,uio", "uio_pdrv_genirq"),
    ],
)
def test_a_node_that_no_driver_took_names_the_module(pynq: Tree, compatible: str, module: str) -> None:
    (pynq.root / "lib/modules/5.15.19-xilinx-v2022.1/modules.builtin").unlink()
    found = pynq.device("node", compatible).one("unbound")
    assert (found.state, found.advice) == (State.WRONG, f"modprobe {module}")


@pytest.mark.parametrize(
    ("compatible", "words"),
    [
        ("xlnx,pr-decoupler", ("xilinx_pr_decoupler is not in this kernel", "CONFIG_XILINX_PR_DECOUPLER")),
        ("fpga-cm,window", ("cm_window is not built for this kernel", "fpga-cm-dkms")),
    ],
)
def test_a_module_that_the_kernel_lacks_is_told_from_one_that_is_not_loaded(
    pynq: Tree, compatible: str, words: tuple[str, ...]
) -> None:
    modules = "lib/modules/5.15.19-xilinx-v2022.1"
    (pynq.root / modules / "modules.builtin").unlink()
    pynq.put(f"{modules}/modules.dep", "updates/dkms/cm_dma.ko:\nkernel/drivers/uio/uio.ko.xz:\n")
    found = pynq.device("node", compatible).one("unbound")
    assert all(word in found.advice for word in words)
    pynq.put(f"{modules}/modules.dep", f"kernel/{words[0].split(' ')[0].replace('_', '-')}.ko:\n")
    assert pynq.one("unbound").advice.startswith("modprobe ")


def test_a_kernel_without_the_uio_driver_is_pointed_to_ours(petalinux: Tree) -> None:
    release = (petalinux.root / "proc/sys/kernel/osrelease").read_text().strip()
    petalinux.put(f"lib/modules/{release}/modules.dep", "updates/dkms/cm_window.ko:\n")
    found = petalinux.one("of_id")
    assert (found.state, found.detail) == (State.MISSING, "not in this kernel")
    assert found.advice.startswith("modprobe cm_window")
    petalinux.put("proc/modules", "cm_window 28672 0 - Live 0x0\n")
    assert petalinux.one("of_id").state is State.OK


def test_a_node_that_its_driver_refused_points_to_the_log(pynq: Tree) -> None:
    found = pynq.device("40000000.control", "fpga-cm,uio", "generic-uio").one("unbound")
    assert "dmesg | grep 40000000.control" in found.advice
    assert "of_id" in found.advice


def test_a_bound_node_is_not_a_finding(pynq: Tree) -> None:
    assert pynq.device("40000000.control", "fpga-cm,uio", driver="uio_pdrv_genirq").found("unbound") == ()


def test_an_engine_that_is_in_the_tree_twice_is_reported(petalinux: Tree) -> None:
    found = petalinux.one("twice")
    assert found.detail == "a0000000.dma and a0000000.dma-controller"
    assert "Remove PL from device tree" in found.advice


def test_an_engine_says_its_length_register_and_coherence(petalinux: Tree) -> None:
    first, _ = petalinux.found("engine")
    assert first.detail == "length register of 26 bits (67108863 bytes); not coherent: each frame is synchronised"
    coherent = petalinux.device("b0000000.dma", "xlnx,axi-vdma-1.00.a", driver="xilinx-vdma", dma__coherent=b"")
    assert coherent.found("engine")[-1].detail == "coherent"


def test_an_engine_whose_length_register_the_tree_does_not_say_is_wrong(pynq: Tree) -> None:
    found = pynq.device("40400000.dma", "xlnx,axi-dma-1.00.a", driver="xilinx-vdma").one("engine")
    assert found.state is State.WRONG
    assert "14 bits" in found.advice


def test_a_channel_without_scatter_gather_is_reported(pynq: Tree) -> None:
    folder = "sys/class/cm_dma/cm_dma!camera"
    pynq.put(f"{folder}/caps", "residue simple\n").put(f"{folder}/max_length", "16383\n")
    found = pynq.one("channel")
    assert (found.state, found.name, found.detail) == (State.WRONG, "camera", "residue simple, at most 16383 bytes")
    assert "Enable Scatter Gather Engine" in found.advice


# ---- ports, clocks, others ----------------------------------------------------------


def test_port_widths_that_nothing_sets_are_reported(kria: Tree) -> None:
    found = kria.device("cm-afi", "xlnx,afi-fpga").one("afi")
    assert found.state is State.WRONG
    assert "boot loader" in found.advice


def test_port_widths_that_the_kernel_set_are_good(kria: Tree) -> None:
    assert kria.device("cm-afi", "xlnx,afi-fpga", driver="afi-fpga").one("afi").state is State.OK


def test_clocks_are_named_with_their_rates(kria: Tree) -> None:
    kria.put("sys/class/cm_clock/pl_clk0/rate", "99999001\n").put("sys/class/cm_clock/pl_clk0/enable", "1\n")
    assert kria.one("clock").detail == "99.999001 MHz"


def test_clocks_that_cannot_be_set_are_reported(kria: Tree) -> None:
    found = kria.one("clock")
    assert found.state is State.MISSING
    assert "modprobe cm_clock" in found.advice


@pytest.mark.parametrize(
    ("comm", "advice"),
    [
        ("dfx-mgrd", "xmutil unloadapp"),
        ("fpgad", "snap stop"),
        ("start_pl_server", "disable --now pl_server"),
    ],
)
def test_another_manager_of_the_same_pl_is_reported_with_how_to_end_it(tmp_path: Path, comm: str, advice: str) -> None:
    tree = board(tmp_path, "x", "xlnx,zynqmp", release="6.6", cma=1, command_line="").process(77, comm)
    found = tree.one("other")
    assert (found.state, found.path) == (State.WRONG, "/proc/77")
    assert advice in found.advice


def test_the_absence_of_other_managers_is_reported_too(tmp_path: Path) -> None:
    tree = board(tmp_path, "x", "xlnx,zynqmp", release="6.6", cma=1, command_line="")
    assert tree.one("other").state is State.OK


def test_everything_that_is_wrong_has_advice(petalinux: Tree) -> None:
    assert all(f.advice for f in survey(petalinux.root).findings if f.state is not State.OK)


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

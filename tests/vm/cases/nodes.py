# SPDX-License-Identifier: Apache-2.0
"""Nodes that an overlay brings, and the drivers that they should get."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cm.formats import fdt

PLATFORM = Path("/sys/bus/platform/devices")
# compatible string → the kernel's driver; the first two are linux-xlnx's alone
MAINLINE_HAS_NONE = ("xlnx,zynq-afi-fpga", "xlnx,afi-fpga")
DRIVERS = {
    "fpga-cm,window": "cm_window",
    "fpga-cm,uio": "uio_pdrv_genirq",
    "fpga-cm,clocks": "cm_clock",
    "fpga-cm,dma-client": "cm_dma",
    "fpga-cm,decoupler": "xlnx_pr_decoupler",
    "fpga-cm,icap-loader": "cm_icap",
    "fpga-cm,polled-intc": "cm_polled_intc",
    "xlnx,xps-intc-1.00.a": "cm_axi_intc",
    "xlnx,axi-dma-1.00.a": "xilinx-vdma",
    "xlnx,axi-mcdma-1.00.a": "xilinx-vdma",
    "xlnx,axi-vdma-1.00.a": "xilinx-vdma",
    "fpga-region": "of-fpga-region",
}


def compatibles(blob: bytes) -> dict[str, str]:
    """Name of each node of an overlay that is to be a device → its first compatible string."""
    root = fdt.unpack(blob)
    return {
        node.name: node.text("compatible") or ""
        for path, node in root.walk()
        if "compatible" in node.properties and "dma-channel" not in path
    }


def device_of(node: str) -> Path | None:
    """The platform device of a node, by the node's name."""
    return next((found for found in _devices() if _node(found).name == node), None)


def driver_of(node: str) -> str:
    """The driver of a node's device: "" where none is bound, "no device" where there is none."""
    found = device_of(node)
    if found is None:
        return "no device"
    link = found / "driver"
    return link.readlink().name if link.is_symlink() else ""


def drivers(blob: bytes) -> dict[str, str]:
    """Name of each node of an overlay → its driver now."""
    return {name: driver_of(name) for name in compatibles(blob)}


def expected(blob: bytes) -> dict[str, str]:
    """Name of each node of an overlay → the driver that mainline and our modules have for it."""
    return {
        name: "" if compatible in MAINLINE_HAS_NONE else DRIVERS[compatible]
        for name, compatible in compatibles(blob).items()
    }


def _devices() -> Iterator[Path]:
    for found in PLATFORM.iterdir():
        if (found / "of_node").exists():
            yield found


def _node(found: Path) -> Path:
    return (found / "of_node").resolve()

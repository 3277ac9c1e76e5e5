# SPDX-License-Identifier: Apache-2.0
"""Nodes from overlays: whether a driver was bound to each, and what the DMA engines can do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine, PlatformDevice

# compatible string → module that binds it
DRIVERS = {
    "fpga-cm,window": "cm_window",
    "fpga-cm,uio": "uio_pdrv_genirq",
    "fpga-cm,dma-client": "cm_dma",
    "fpga-cm,icap-loader": "cm_icap",
    "fpga-cm,polled-intc": "cm_intc",
    "xlnx,xps-intc-1.00.a": "cm_intc",
    "fpga-cm,decoupler": "xilinx_pr_decoupler",
    "fpga-cm,clocks": "cm_clock",
    "xlnx,axi-dma-1.00.a": "xilinx_dma",
    "xlnx,axi-vdma-1.00.a": "xilinx_dma",
    "xlnx,axi-mcdma-1.00.a": "xilinx_dma",
    "xlnx,pr-decoupler": "xilinx_pr_decoupler",
    "fpga-region": "of_fpga_region",
}
# module of the kernel → what its configuration has to say
OPTIONS = {
    "uio_pdrv_genirq": "CONFIG_UIO_PDRV_GENIRQ",
    "xilinx_dma": "CONFIG_XILINX_DMA",
    "xilinx_pr_decoupler": "CONFIG_XILINX_PR_DECOUPLER",
    "of_fpga_region": "CONFIG_OF_FPGA_REGION",
}
_ENGINES = ("xlnx,axi-dma-1.00.a", "xlnx,axi-vdma-1.00.a", "xlnx,axi-mcdma-1.00.a")
_DEFAULT_BITS = 23  # of the length register, as the kernel's driver assumes if the tree does not say


def checks(machine: Machine) -> Iterator[Finding]:
    """Unbound nodes, engines, channels, nodes that stand twice."""
    for device in machine.devices:
        module = next((DRIVERS[name] for name in device.compatible if name in DRIVERS), None)
        if module is not None and not device.driver:
            yield _unbound(machine, device, module)
    yield from _twice(machine)
    for device in machine.devices:
        if any(name in _ENGINES for name in device.compatible):
            yield _engine(device)
    yield from _channels(machine)


def _unbound(machine: Machine, device: PlatformDevice, module: str) -> Finding:
    if module in machine.loaded or module in machine.built_in:
        advice = f"{module} exists but did not bind: dmesg | grep {device.name}"
        if module == "uio_pdrv_genirq":
            advice += "; its of_id has to be one of the node's compatible strings"
    elif machine.has_module(module) is False:
        advice = absent(module)
    else:
        advice = f"modprobe {module}"
    detail = f"no driver for {device.compatible[0]}"
    return Finding("unbound", device.name, str(device.path), State.WRONG, detail, advice)


def absent(module: str) -> str:
    """What to do about a module that the running kernel does not have at all."""
    if module in OPTIONS:
        return f"{module} is not in this kernel: one with {OPTIONS[module]} is needed (docs/install.md lists some)"
    return f"{module} is not built for this kernel: apt install fpga-cm-dkms, or make -C kmod"


def _twice(machine: Machine) -> Iterator[Finding]:
    """The same engine described by the board's tree and by an overlay."""
    engines = [d for d in machine.devices if d.base is not None and any(n in _ENGINES for n in d.compatible)]
    for base, count in Counter(d.base for d in engines).items():
        if count > 1:
            names = [d for d in engines if d.base == base]
            advice = (
                "the board's tree describes the PL too: PetaLinux, 'Remove PL from device tree' in its configuration, "
                "or delete the nodes in system-user.dtsi"
            )
            detail = " and ".join(d.name for d in names)
            yield Finding("twice", f"{base:#x}", str(names[0].path), State.WRONG, detail, advice)


def _engine(device: PlatformDevice) -> Finding:
    coherent = "coherent" if "dma-coherent" in device.properties else "not coherent: each frame is synchronised"
    if "xlnx,axi-dma-1.00.a" not in device.compatible:
        return Finding("engine", device.name, str(device.path), State.OK, coherent)
    bits = device.cell("xlnx,sg-length-width")
    if bits is None:
        detail = f"no xlnx,sg-length-width: the driver takes {_DEFAULT_BITS} bits; {coherent}"
        advice = "the core's default is 14 bits, and longer transfers are cut without an error: say it in the tree"
        return Finding("engine", device.name, str(device.path), State.WRONG, detail, advice)
    detail = f"length register of {bits} bits ({(1 << bits) - 1} bytes); {coherent}"
    return Finding("engine", device.name, str(device.path), State.OK, detail)


def _channels(machine: Machine) -> Iterator[Finding]:
    """What cm_dma says of its channels, in the place where it says it."""
    folder = "sys/class/cm_dma"
    for name in machine.names(folder):
        caps = machine.text(folder, name, "caps").split()
        longest = machine.text(folder, name, "max_length")
        if not (caps or longest):
            continue
        path = str(machine.root.join(folder, name))
        detail = f"{' '.join(caps) or 'nothing beside transfers'}, at most {longest or '?'} bytes"
        if "simple" in caps:
            advice = (
                "the engine has no scatter/gather: one transfer at a time, and between two nothing is taken, so a "
                "source that cannot wait loses data; 'Enable Scatter Gather Engine' in the design changes that"
            )
            yield Finding("channel", name.removeprefix("cm_dma!"), path, State.WRONG, detail, advice)
        else:
            yield Finding("channel", name.removeprefix("cm_dma!"), path, State.OK, detail)

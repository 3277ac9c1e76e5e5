# SPDX-License-Identifier: Apache-2.0
"""The kernel and its tree: symbols, UIO's compatible string, contiguous memory, firmware, modules."""

from __future__ import annotations

import re
from collections.abc import Iterator

from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine
from cm.device.paths import Root

_UIO = "uio_pdrv_genirq"
_OUR_UIO = ("fpga-cm,uio", "generic-uio")
_LEAST_CMA = 64 << 10  # KiB: eight frames of 1080p in RGBA
# Modules that provide what is looked for here; those built into the kernel do not show in /proc/modules.
MODULES = ("uio", "uio_pdrv_genirq", "xilinx_dma", "cm_dma", "cm_icap", "cm_overlay", "fpga_mgr", "fpga_region")
_MODULES_ADVICE = "modprobe it, unless it is built into the kernel or the board does not need it (docs/kernel.md)"


def checks(machine: Machine) -> Iterator[Finding]:
    """What the kernel is, and what it was started with."""
    model = machine.text("proc/device-tree/model") or "?"
    detail = f"{model} ({machine.family}), Linux {machine.release or '?'}"
    yield Finding("board", "board", "/proc/device-tree", State.OK, detail)
    yield _symbols(machine)
    yield _uio(machine)
    yield _cma(machine)
    if (path := _firmware_path(machine)) is not None:
        yield path
    if machine.family == "zynqmp":
        yield _firmware(machine)


def _symbols(machine: Machine) -> Finding:
    path = "/proc/device-tree/__symbols__"
    found = machine.names(path.lstrip("/"))
    if not found:
        advice = (
            "overlays that name labels are refused (-EINVAL): build the board's tree with dtc -@ (Yocto and PetaLinux: "
            "EXTRA_DTC_ARGS or DTC_FLAGS of the device-tree recipe; Ubuntu for Kria and PYNQ have them)"
        )
        return Finding("symbols", "__symbols__", path, State.MISSING, "the live tree has no symbols", advice)
    lacking = [label for label in _labels(machine) if label not in found]
    if lacking:
        advice = "overlays of cm build name these labels: use the kernel's own tree of the board, or add them to yours"
        return Finding("symbols", "__symbols__", path, State.WRONG, f"no label {', '.join(lacking)}", advice)
    return Finding("symbols", "__symbols__", path, State.OK, f"{len(found)} labels")


def _labels(machine: Machine) -> tuple[str, ...]:
    return ("intc", "clkc", "devcfg") if machine.family == "zynq" else ("gic", "zynqmp_clk", "zynqmp_pcap")


def _uio(machine: Machine) -> Finding:
    """The parameter itself cannot be read back, so we look for where it was set."""
    where = machine.root.join("sys/module", _UIO)
    built_in = _UIO not in machine.loaded and where.exists()
    value = _of_id_of_command_line(machine) or ("" if built_in else _of_id_of_modprobe(machine))
    if "cm_window" in machine.loaded:
        return _windows(machine, built_in, value)
    if _UIO not in machine.loaded and not where.exists():
        if machine.has_module(_UIO) is False:
            advice = "modprobe cm_window, which does without it; or a kernel with CONFIG_UIO_PDRV_GENIRQ"
            return Finding("of_id", _UIO, str(where), State.MISSING, "not in this kernel", advice)
        advice = "modprobe uio_pdrv_genirq of_id=fpga-cm,uio (for good: system/modprobe.d; the service loads it)"
        return Finding("of_id", _UIO, str(where), State.MISSING, "not loaded", advice)
    kind = "built in" if built_in else "module"
    if value in _OUR_UIO:
        return Finding("of_id", _UIO, str(where), State.OK, f"{kind}, of_id={value}")
    if built_in:
        advice = (
            "it is built into the kernel, where modprobe's options do not reach it: put uio_pdrv_genirq.of_id="
            "fpga-cm,uio on the kernel's command line (PYNQ, PetaLinux: bootargs; Ubuntu: flash-kernel or extlinux)"
        )
    else:
        advice = "options uio_pdrv_genirq of_id=fpga-cm,uio in /etc/modprobe.d, then rmmod and modprobe it"
        if _of_id_of_command_line(machine):  # modprobe puts the command line's options behind its own: the last counts
            advice = f"modprobe.d has no effect where the kernel's command line has {_UIO}.of_id=: change it there"
    return Finding("of_id", _UIO, str(where), State.WRONG, f"{kind}, of_id={value or 'not set'}", advice)


def _windows(machine: Machine, built_in: bool, of_id: str) -> Finding:
    """A driver that is built in is asked before a module, so cm_window gets what that one does not know."""
    path = str(machine.root.join("sys/module/cm_window"))
    if not (built_in and of_id in _OUR_UIO):
        return Finding("of_id", "cm_window", path, State.OK, "cm_window serves the register windows")
    detail = f"{_UIO} is built in with of_id={of_id} and takes the windows first: none is lent"
    advice = (
        f"another {_UIO}.of_id= on the kernel's command line, such as none; or for each window: echo cm_window "
        ">/sys/bus/platform/devices/NAME/driver_override, its driver's unbind, then NAME to drivers_probe"
    )
    return Finding("of_id", "cm_window", path, State.WRONG, detail, advice)


def _firmware_path(machine: Machine) -> Finding | None:
    """A newline in it is part of the name for Linux 6.1."""
    path = "sys/module/firmware_class/parameters/path"
    value = machine.raw(path).decode("utf-8", "replace").removesuffix("\n")
    if not value.endswith("\n"):
        return None
    advice = f"printf %s {value.strip()} >/{path}: Linux 6.1 finds no file in a folder whose name ends in a newline"
    return Finding("firmware", "firmware_class.path", f"/{path}", State.WRONG, "written with a newline (echo)", advice)


def _of_id_of_command_line(machine: Machine) -> str:
    """Its value; the kernel takes quotes away, which /proc/cmdline still has (PYNQ)."""
    values = [word.partition("=")[2] for word in machine.command_line if word.startswith(f"{_UIO}.of_id=")]
    return values[-1].strip('"') if values else ""


def _of_id_of_modprobe(machine: Machine) -> str:
    found = ""
    for folder in ("usr/lib/modprobe.d", "lib/modprobe.d", "etc/modprobe.d", "run/modprobe.d"):
        for name in machine.names(folder):
            text = machine.text(folder, name) if name.endswith(".conf") else ""
            for value in re.findall(rf"^\s*options\s+{_UIO}\s.*?\bof_id=(\S+)", text, re.MULTILINE):
                found = value
    return found


def _cma(machine: Machine) -> Finding:
    path = "/proc/meminfo"
    values = dict(re.findall(r"^(Cma\w+):\s+(\d+) kB", machine.text(path.lstrip("/")), re.MULTILINE))
    total, free = int(values.get("CmaTotal", 0)), int(values.get("CmaFree", 0))
    if not total:
        advice = "DMA buffers need contiguous memory: a kernel with CONFIG_DMA_CMA, and cma=256M on its command line"
        return Finding("cma", "cma", path, State.MISSING, "none", advice)
    detail = f"{total >> 10} MiB, {free >> 10} free"
    if re.search(r"zone +HighMem\n(?: .*\n)*? +cma +[1-9]", machine.text("proc/zoneinfo")):
        detail += ", in high memory: buffers are uncached, and slower to read"
    if total < _LEAST_CMA:
        advice = f"less than {_LEAST_CMA >> 10} MiB: slots of long frames do not fit; cma=256M on the command line"
        return Finding("cma", "cma", path, State.WRONG, detail, advice)
    return Finding("cma", "cma", path, State.OK, detail)


def _firmware(machine: Machine) -> Finding:
    """Whether the PMU firmware allows the ICAP to be selected is known only if cm_icap has asked for it."""
    ports = [d for d in machine.devices if "fpga-cm,icap-loader" in d.compatible]
    path = "/sys/firmware/zynqmp" if machine.exists("sys/firmware/zynqmp") else "/proc/device-tree/firmware"
    if not ports:
        return Finding("pmufw", "PMU firmware", path, State.OK, "no ICAP in the tree, so it is not asked")
    if any(d.driver for d in ports):
        return Finding("pmufw", "PMU firmware", path, State.OK, "cm_icap is bound")
    advice = (
        "cm_icap did not bind: modprobe it; where dmesg says -EACCES, the PMU firmware refuses to select the ICAP: "
        "allow 0xFFCA3008 in its pm_mmio_access.c (docs/boards/kv260.md), or use loader: auto or fpga_manager"
    )
    return Finding("pmufw", "PMU firmware", path, State.WRONG, "the ICAP's driver is not bound", advice)


def modules(root: Root) -> Iterator[Finding]:
    """Which are loaded. A simulated board has no kernel of its own, so there is nothing to say about modules."""
    path = root.join("proc/modules")
    if root.simulated and not path.exists():
        return
    try:
        loaded = {line.split(" ", 1)[0] for line in path.read_text(encoding="ascii", errors="replace").splitlines()}
    except OSError:
        loaded = set()
    for name in MODULES:
        if name in loaded:
            yield Finding("module", name, str(path), State.OK, "loaded")
        else:
            yield Finding("module", name, str(path), State.MISSING, "not loaded", _MODULES_ADVICE)

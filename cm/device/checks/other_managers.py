# SPDX-License-Identifier: Apache-2.0
"""Other programs that configure this PL: two that do not know of each other undo each other's work."""

from __future__ import annotations

from collections.abc import Iterator

from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine

_OVERLAYS, _CONFIGS = "sys/kernel/config/device-tree/overlays", "lib/firmware/cm"
_DFX_MGR = "xmutil unloadapp; systemctl disable --now dfx-mgr dfx-mgr-fw-load"
# name of the process (its first 15 characters) → what to do
_OTHERS = {
    "dfx-mgrd": _DFX_MGR,
    "dfx-mgr": _DFX_MGR,
    "fpgad": "snap stop --disable fpgad",
    "pl_server": "systemctl disable --now pl_server (PYNQ)",
    "start_pl_server": "systemctl disable --now pl_server (PYNQ)",
    "jupyter-noteboo": "a notebook of PYNQ that makes an Overlay loads the PL: systemctl stop jupyter",
    "jupyter-lab": "a notebook of PYNQ that makes an Overlay loads the PL: systemctl stop jupyter",
}
# unit that is enabled → what it does at each boot, and what ends that
_UNITS = {
    "bootpy.service": ("runs /boot/boot.py, which may load base.bit (PYNQ)", "systemctl disable --now bootpy"),
    "clear_pl_statefile.service": (
        "inserts the overlay of Kria-PYNQ; its script in /etc/profile.d does so at each login of root",
        "systemctl disable --now clear_pl_statefile, and move that script away",
    ),
    "dfx-mgr.service": ("may load an application, before 2025.1 in its ExecStartPre", _DFX_MGR),
    "dfx-mgr-fw-load.service": ("loads the package named in /etc/dfx-mgrd/default_firmware", _DFX_MGR),
}


def checks(machine: Machine) -> Iterator[Finding]:
    """One finding for each such program, and for each unit that loads at boot; or one that says that there is none."""
    found = running(machine)
    for comm, pid in sorted(found.items()):
        detail = f"runs (pid {pid}), and may load the PL behind the manager's back"
        yield Finding("other", comm, f"/proc/{pid}", State.WRONG, detail, _OTHERS[comm])
    units = {unit: path for path, unit in _enabled(machine) if unit in _UNITS}
    for unit, path in sorted(units.items()):
        detail, advice = _UNITS[unit]
        yield Finding("other", unit, path, State.WRONG, detail, advice)
    strange = _strange_overlays(machine)
    for name in strange:
        advice = f"xmutil unloadapp, or rmdir /{_OVERLAYS}/{name}; then load the mode again with --force"
        detail = "an overlay that is none of an imported configuration: it has loaded another design"
        yield Finding("other", name, f"/{_OVERLAYS}/{name}", State.WRONG, detail, advice)
    if not (found or units or strange):
        yield Finding("other", "managers", "/proc", State.OK, "no other program is known to load this PL")


def running(machine: Machine) -> dict[str, str]:
    """Programs that may load the PL, and their pids."""
    return {comm: pid for pid, comm in _processes(machine) if comm in _OTHERS}


def told(machine: Machine) -> str:
    """Which of them run, for a sentence; empty where none is known."""
    return ", ".join(f"{comm} runs (pid {pid}; {_OTHERS[comm]})" for comm, pid in sorted(running(machine).items()))


def _processes(machine: Machine) -> Iterator[tuple[str, str]]:
    for pid in machine.names("proc"):
        if pid.isdecimal():
            yield pid, machine.text("proc", pid, "comm")


def _strange_overlays(machine: Machine) -> list[str]:
    """Overlays that load the PL, and neither are of an imported configuration nor load a region of ours (cm-REGION)."""
    files = (name for config in machine.names(_CONFIGS) for name in machine.names(_CONFIGS, config))
    ours = {name.removesuffix(".dtbo") for name in files if name.endswith(".dtbo")}
    others = [name for name in machine.names(_OVERLAYS) if name not in ours and not name.startswith("cm-")]
    return [name for name in others if b"firmware-name" in machine.raw(_OVERLAYS, name, "dtbo")]


def _enabled(machine: Machine) -> Iterator[tuple[str, str]]:
    for folder in ("etc/systemd/system", "lib/systemd/system", "usr/lib/systemd/system"):
        for target in machine.names(folder):
            if target.endswith((".wants", ".requires")):
                yield from ((f"/{folder}/{target}/{unit}", unit) for unit in machine.names(folder, target))

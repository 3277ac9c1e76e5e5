# SPDX-License-Identifier: Apache-2.0
"""Other programs that configure this PL: two that do not know of each other undo each other's work."""

from __future__ import annotations

from collections.abc import Iterator

from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine

# name of the process (its first 15 characters) → what to do
_OTHERS = {
    "dfx-mgrd": "xmutil unloadapp; systemctl disable --now dfx-mgr",
    "dfx-mgr": "xmutil unloadapp; systemctl disable --now dfx-mgr",
    "fpgad": "snap stop --disable fpgad",
    "pl_server": "systemctl disable --now pl_server (PYNQ)",
    "start_pl_server": "systemctl disable --now pl_server (PYNQ)",
    "jupyter-noteboo": "a notebook of PYNQ that makes an Overlay loads the PL: systemctl stop jupyter",
    "jupyter-lab": "a notebook of PYNQ that makes an Overlay loads the PL: systemctl stop jupyter",
}


def checks(machine: Machine) -> Iterator[Finding]:
    """One finding for each such program, or one that says that there is none."""
    found = {comm: pid for pid, comm in _processes(machine) if comm in _OTHERS}
    for comm, pid in sorted(found.items()):
        detail = f"runs (pid {pid}), and may load the PL behind the manager's back"
        yield Finding("other", comm, f"/proc/{pid}", State.WRONG, detail, _OTHERS[comm])
    if not found:
        yield Finding("other", "managers", "/proc", State.OK, "no other program is known to load this PL")


def _processes(machine: Machine) -> Iterator[tuple[str, str]]:
    for pid in machine.names("proc"):
        if pid.isdecimal():
            yield pid, machine.text("proc", pid, "comm")

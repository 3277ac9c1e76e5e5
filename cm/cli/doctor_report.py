# SPDX-License-Identifier: Apache-2.0
"""``cm doctor --report``: a form in Markdown, filled in as far as a program can; the rest is for people."""

from __future__ import annotations

from collections.abc import Sequence

from cm._version import __version__
from cm.device.checks.machine import Machine
from cm.device.paths import Root

_QUESTIONS = (
    "Board and revision, boot medium",
    "Image (name and version of PYNQ, Ubuntu for Kria, PetaLinux, …)",
    "Design (cm build project, Vivado version), and how its static part was loaded",
    "Step of docs/boards/ that was reached, and what the first one that failed printed",
    "`cm stream capture`: frames that came, and whether their content was right",
    "`cm mode`: modules that were exchanged, and how long `cm status` says it took",
    "`make device-suite BOARD=hw`: passed, failed, skipped",
    "What was in `dmesg` from the first overlay on",
)


def report(root: str | None, findings: Sequence[dict[str, str]], verdict: Sequence[str]) -> str:
    """The form; nothing in it names a user, a host or an address of a network."""
    machine = Machine(Root.of(root))
    lines = ["# A run on a board", "", f"- fpga-cm {__version__}"]
    lines += [f"- {what}: {value}" for what, value in _facts(machine) if value]
    lines += [f"- verdict: {'; '.join(verdict) or 'usable'}", "", "## By hand", ""]
    lines += [f"- [ ] {question}:" for question in _QUESTIONS]
    lines += ["", "## Found", "", "| state | what | name | detail | what to do |", "|---|---|---|---|---|"]
    lines += [_row(finding) for finding in findings]
    return "\n".join(lines)


def _facts(machine: Machine) -> Sequence[tuple[str, str]]:
    return (
        ("board", machine.text("proc/device-tree/model")),
        ("compatible", ", ".join(filter(None, machine.compatible))),
        ("kernel", machine.release),
        ("modules of ours", ", ".join(sorted(name for name in machine.loaded if name.startswith("cm_")))),
        ("overlays", ", ".join(machine.names("sys/kernel/config/device-tree/overlays"))),
    )


def _row(finding: dict[str, str]) -> str:
    advice = finding["advice"] if finding["state"] != "ok" else ""
    cells = (finding["state"], finding["kind"], finding["name"], finding["detail"], advice)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

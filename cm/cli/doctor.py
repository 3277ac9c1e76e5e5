# SPDX-License-Identifier: Apache-2.0
"""``cm doctor``: what this machine has, and what to do about what it lacks; ``--report``: a form to fill in."""

from __future__ import annotations

import argparse
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from cm._version import __version__
from cm.cli.colours import painted
from cm.cli.common import add_board_options, print_json
from cm.cli.connection import connected, where
from cm.device.check_result import Finding, State
from cm.device.checks.machine import Machine
from cm.device.paths import Root
from cm.wire.messages.json_values import plain

if TYPE_CHECKING:
    from cm.device.survey import Survey
    from cm.formats import fdt

REQUIRED = ("cffi", "fastjsonschema", "numpy", "protobuf", "pyyaml", "pyzmq")
OPTIONAL = {
    "pillow": "fpga-cm[demo]: photographs for the simulated camera",
    "pyslang": "fpga-cm[build]: interfaces of Verilog sources",
    "tree-sitter-vhdl": "fpga-cm[build]: interfaces of VHDL sources",
    "scipy": "fpga-cm[build]: cm build partition",
    "matplotlib": "fpga-cm[bench]: plots",
    "iceoryx2": "fpga-cm[bench]: a baseline",
    "eclipse-zenoh": "fpga-cm[zenoh]: fleets, cm bridge ros",
}
_COLOURS = {"ok": "green", "-": "dim", "missing": "yellow", "denied": "red", "wrong": "red"}
_TIMEOUT = 2.0  # seconds for a manager's answer


def fill_parser(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = (
        "Look for devices, kernel modules, libraries and a running manager; nothing is "
        "opened or changed. Exit status 0 if the board can be used, or if there is no "
        "sign of one (a simulated board works everywhere); 1 if something that is needed "
        "is missing or denied."
    )
    parser.add_argument(
        "--root",
        metavar="DIR",
        help="folder that holds the board's /dev and /sys (default: $CM_ROOT, /); all of it is listed",
    )
    parser.add_argument("--report", action="store_true", help="print a form to report a run on a board with, filled in")
    add_board_options(parser, run)


def run(args: argparse.Namespace) -> int:
    """Look and say; the exit status."""
    from cm.device.survey import survey

    found = survey(args.root)
    findings = [_board(found), _manager(args), *found.findings, *_clashes(Root.of(found.root)), *_packages(), _curve()]
    verdict = _verdict(found, findings)
    if args.report:
        print(report(args.root, findings, verdict))
    elif args.json:
        told = [plain(finding) for finding in findings]
        print_json({"usable": not verdict, "problems": verdict, "simulated": found.simulated, "findings": told})
    elif args.root or found.usable or _expected(found):
        _print(findings, verdict, found)
    else:
        _print_briefly(findings, verdict)
    return 1 if verdict else 0


def _board(found: Survey) -> Finding:
    """The machine that was looked at."""
    machine = Machine(Root.of(found.root))
    if found.simulated:
        return Finding("board", "board", found.root, State.OK, "a simulated board")
    model = machine.text("proc/device-tree/model")
    if model:
        return Finding("board", "board", found.root, State.OK, ", ".join(filter(None, (model, machine.release))))
    advice = "'cm serve --sim' brings a simulated board; --connect reaches one elsewhere"
    return Finding("board", "board", found.root, State.MISSING, f"this {platform.machine()} machine is none", advice)


def _clashes(root: Root) -> Iterator[Finding]:
    """What the overlays of imported configurations ask for, and another node of the live tree has."""
    from cm.formats.live_tree import live_clashes

    folders = sorted({path.parent for path in root.join("lib/firmware/cm").glob("*/*.dtbo")})
    configs = {folder: _overlays_in(folder) for folder in folders}
    for folder, overlays in configs.items():
        for clash in live_clashes(root, overlays, configs.values()):  # when one goes, another comes
            yield Finding("clash", folder.name, str(folder), State.WRONG, clash.text, clash.advice)


def _overlays_in(folder: Path) -> dict[str, fdt.FdtNode]:
    """The overlays of a configuration: its own first, as those of modules stand on it."""
    from cm.formats import fdt

    found = {}
    for path in sorted(folder.glob("*.dtbo"), key=lambda path: (not path.stem.endswith("_static"), path.name)):
        with suppress(OSError, fdt.FdtError):
            found[path.name] = fdt.unpack(path.read_bytes())
    return found


def _packages() -> Iterator[Finding]:
    yield Finding("python", "python", "", State.OK, f"{platform.python_version()} on {platform.machine()}")
    for name in (*REQUIRED, *OPTIONAL):
        try:
            yield Finding("package", name, "", State.OK, metadata.version(name))
        except metadata.PackageNotFoundError:
            advice = f"optional: {OPTIONAL[name]}" if name in OPTIONAL else "reinstall fpga-cm: it needs this package"
            yield Finding("package", name, "", State.MISSING, "not installed", advice)


def _curve() -> Finding:
    import zmq

    if zmq.has("curve"):
        return Finding("curve", "curve", "", State.OK, f"libzmq {zmq.zmq_version()}")
    advice = "connections over TCP cannot be encrypted: use a pyzmq wheel, or a libzmq built with libsodium"
    return Finding("curve", "curve", "", State.MISSING, f"libzmq {zmq.zmq_version()} without CURVE", advice)


def _manager(args: argparse.Namespace) -> Finding:
    """Whether a manager answers, and in which mode it is."""
    from cm.client.find_manager import default_runtime_dir
    from cm.errors import CmError, NotFound
    from cm.wire.messages.status import PrMode

    place = args.connect or str(args.runtime_dir or default_runtime_dir())
    try:
        with connected(args, _TIMEOUT) as board:
            status = board.status
    except NotFound as error:
        advice = "start one with 'cm serve' (or 'cm serve --sim')"
        return Finding("manager", "manager", place, State.MISSING, str(error), advice)
    except (CmError, OSError) as error:
        return Finding("manager", "manager", place, State.WRONG, str(error), "see docs/troubleshooting.md")
    told = f"version {status.version}, {where(status) or 'nothing loaded'}"
    if status.pr_mode is PrMode.ERROR:
        why = f": {status.last_error.message}" if status.last_error else ""
        advice = "mend the cause, then load any mode: 'cm load CONFIG/MODE'"
        return Finding("manager", "manager", place, State.WRONG, told + why, advice)
    return Finding("manager", "manager", place, State.OK, told)


def _verdict(found: Survey, findings: Sequence[Finding]) -> list[str]:
    """What makes this machine unusable, in sentences; none where no hardware is expected."""
    problems = [
        f"the package {f.name} is not installed"
        for f in findings
        if f.kind == "package" and f.state is State.MISSING and f.name in REQUIRED
    ]
    if found.usable or not _expected(found):
        return problems
    denied = [f"{f.name}: {f.path} may not be used ({f.advice})" for f in found.findings if f.state is State.DENIED]
    return problems + (denied or ["there is no way to configure the PL: no ICAP, fpga_manager or overlays"])


def _expected(found: Survey) -> bool:
    """Whether this should be a board: its root was named, or it has any FPGA device of ours.

    Overlays and modules do not count, nor UIO: other machines have them too.
    """
    return found.simulated or any(
        f.state is not State.MISSING for kind in ("icap", "fpga_manager", "dma") for f in found.of(kind)
    )


def _print_briefly(findings: Sequence[Finding], verdict: list[str]) -> None:
    """Four lines for a PC, where whatever a board would have is missing, and nothing is wrong."""
    board, manager, python, curve = (
        next(f for f in findings if f.kind == kind) for kind in ("board", "manager", "python", "curve")
    )
    lacking = [f.name for f in findings if f.kind == "package" and f.state is State.MISSING and f.name not in REQUIRED]
    left = f"; not installed, all optional: {', '.join(lacking)}" if lacking else ""
    software = "; ".join(verdict) or f"Python {python.detail}, {curve.detail}{left}"
    rows = (
        ("-", "board", f"{board.detail}: --connect reaches one elsewhere"),
        ("-", "manager", "none answers here")
        if manager.state is State.MISSING
        else (manager.state.value, "manager", manager.detail),
        ("missing" if verdict else "ok", "software", software),
    )
    for mark, kind, text in rows:
        print(f"{painted(f'{mark:8}', _COLOURS[mark], sys.stdout)} {kind:9} {text}")
    print(
        "no FPGA here: 'cm serve --sim' brings a simulated board ('cm doctor --root /' lists what a board would have)"
    )


def _print(findings: Sequence[Finding], verdict: list[str], found: Survey) -> None:
    for finding in findings:
        state = painted(f"{finding.state.value:8}", _COLOURS[finding.state.value], sys.stdout)
        print(f"{state} {finding.kind:13} {finding.name:18} {finding.detail}".rstrip())
        if finding.advice and finding.state is not State.OK:
            print(f"{'':9}→ {finding.advice}")
    print()
    if verdict:
        print("\n".join(f"not usable: {problem}" for problem in verdict))
    elif found.usable:
        wrong = sum(finding.state is State.WRONG for finding in findings)
        note = f", but {wrong} of the above would stop a design that needs it" if wrong else ""
        print("usable" + (" (a simulated board)" if found.simulated else "") + note)
    else:
        print("no FPGA here: 'cm serve --sim' brings a simulated board")


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


def report(root: str | None, findings: Sequence[Finding], verdict: Sequence[str]) -> str:
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


def _row(finding: Finding) -> str:
    advice = finding.advice if finding.state is not State.OK else ""
    cells = (finding.state.value, finding.kind, finding.name, finding.detail, advice)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"

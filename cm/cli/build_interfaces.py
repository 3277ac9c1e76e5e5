# SPDX-License-Identifier: Apache-2.0
"""``cm build interfaces FILE…``: the bus interfaces, clocks, resets and interrupts of HDL modules."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cm.cli.build import add_define_option, add_parameter_option
from cm.cli.common import add_json_option, print_json, print_table
from cm.design.hdl.extract import Sources
from cm.design.hdl.model import ModuleInfo, Problem, Reset
from cm.design.hdl.user_protocols import load_protocols
from cm.design.input_kinds import read_inputs

_DESCRIPTION = """\
Find AXI4, AXI4-Lite, AXI4-Stream and your own protocols, clocks, resets and interrupts in HDL, by Vivado's
attributes first, then by names. Ports that belong to none of them are listed with the reason. Without --top, the
modules that no other module in the files instantiates are shown."""


def fill_interfaces(parser: argparse.ArgumentParser) -> None:
    """Describe the action."""
    parser.description = _DESCRIPTION
    parser.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="Verilog, SystemVerilog, VHDL, .core, component.xml, .xci, .hwh",
    )
    top = "only this module or entity; one with records or interfaces as its flat wrapper shows it"
    parser.add_argument("--top", metavar="NAME", help=top)
    parser.add_argument("--all", action="store_true", help="show every module in the files")
    parser.add_argument("-I", "--include", action="append", default=[], type=Path, metavar="DIR", help="include folder")
    add_define_option(parser)
    add_parameter_option(parser)
    parser.add_argument("--protocols", type=Path, metavar="FILE", help="your own protocols (YAML)")
    add_json_option(parser, run)


def run(args: argparse.Namespace) -> int:
    """Print what was found; 0 even if something could not be determined."""
    modules, problems = _modules(args)
    if args.json:
        found = [as_dict(module) for module in modules]
        found[0]["problems"] += [_problem(problem) for problem in problems]
        print_json(found[0] if len(found) == 1 else found)
        return 0
    for module in modules:
        _print(module)
    for problem in problems:
        print(f"warning: {problem}")
    return 0


def _modules(args: argparse.Namespace) -> tuple[list[ModuleInfo], Sequence[Problem]]:
    protocols = load_protocols(args.protocols) if args.protocols else ()
    wanted = Sources(args.files, args.top, args.include, dict(args.define), dict(args.parameter), protocols)
    given, problems = read_inputs(wanted, args.all)
    return [one.flat if args.top else one.info for one in given], problems


def as_dict(module: ModuleInfo) -> dict[str, Any]:
    """A module as JSON has it: interfaces, and what was left over."""
    return {
        "module": module.name,
        **_fields(module, "file", "line", "language"),
        "parameters": {p.name: p.value for p in module.parameters if not p.local},
        "interfaces": [_fields(interface, *_INTERFACE) for interface in module.interfaces],
        "clocks": [
            _fields(c, "name", "port", "direction", "frequency_hz", "interfaces", "reset") for c in module.clocks
        ],
        "resets": [_fields(r, "name", "port", "polarity", "clock", "why", "may_be") for r in module.resets],
        "interrupts": [_fields(i, "name", "port", "mode", "width", "sensitivity") for i in module.interrupts],
        "leftover": [
            {**_fields(module.port(left.port), "name", "direction", "width"), "reason": left.reason}
            for left in module.leftovers
        ],
        "problems": [_problem(problem) for problem in module.problems],
    }


_INTERFACE = (
    *("name", "protocol", "mode", "ports", "clock", "reset", "reset_polarity", "data_width", "addr_width", "id_width"),
    *("widths", "found_by"),
)


def _fields(thing: object, *names: str) -> dict[str, Any]:
    return {name: getattr(thing, name) for name in names}


def _problem(problem: Problem) -> dict[str, Any]:
    return _fields(problem, "message", "file", "line", "fatal")


def _print(module: ModuleInfo) -> None:
    print(f"{module.name} ({module.language.value}, {module.file})\n")
    _interfaces(module)
    _section("clocks", (f"{c.port} → {', '.join(c.interfaces) or 'no bus'}" for c in module.clocks))
    _section("resets", map(_reset, module.resets))
    _section("interrupts", (f"{i.port} ({'out' if i.mode.value == 'master' else 'in'})" for i in module.interrupts))
    _print_leftovers(module)
    _section("problems", map(str, module.problems))
    print()


def _reset(reset: Reset) -> str:
    """Its level, and what was decided about its clock, and why."""
    level = reset.polarity.value if reset.polarity else "?"
    if reset.may_be:
        return f"{reset.port}, active {level}, of any of {', '.join(reset.may_be)}: not decided"
    of = f", of {reset.clock}: {reset.why}" if reset.clock else ""
    return f"{reset.port}, active {level}{of}"


def _interfaces(module: ModuleInfo) -> None:
    if not module.interfaces:
        print("no bus interface found")
        return
    rows = [
        (i.name, i.protocol, i.mode.value, len(i.ports), i.data_width, i.addr_width, i.clock, i.reset, i.found_by.value)
        for i in module.interfaces
    ]
    print_table(rows, ("interface", "protocol", "mode", "ports", "data", "addr", "clock", "reset", "found by"))


def _print_leftovers(module: ModuleInfo) -> None:
    reasons: dict[str, list[str]] = {}
    for left in module.leftovers:
        reasons.setdefault(left.reason, []).append(left.port)
    lines: list[str] = []
    for reason, ports in reasons.items():
        lines += [f"{reason}:", *textwrap.wrap(", ".join(ports), 100, initial_indent="  ", subsequent_indent="  ")]
    _section("left over", lines)


def _section(title: str, lines: Iterable[str]) -> None:
    found = list(lines)
    if found:
        print(f"\n{title}:")
        for line in found:
            print(f"  {line}")

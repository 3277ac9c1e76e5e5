# SPDX-License-Identifier: Apache-2.0
"""Checks that names in a build schema refer to something, and that values are consistent."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.parts import PARTS, device_of
from cm.design.platforms import platform_of
from cm.design.project.model import ModeSpec, ModuleSpec, Project, RegionSpec, Resources
from cm.schema.construct import Context
from cm.schema.model import Register
from cm.schema.problems import KeyPath, did_you_mean
from cm.schema.rules_registers import check_fields, check_values

_SITE = re.compile(r"([A-Z0-9_]+)_X(\d+)Y(\d+)")
Report = Callable[[KeyPath, str, str, str], None]


def check(project: Project, report: Report) -> None:
    """Report every inconsistency in `project`."""
    if not project.part:
        return  # already reported
    try:
        platform = platform_of(project.part)
        if len(project.clocks) > len(platform.clock_pins):
            message = f"{platform.name} has {len(platform.clock_pins)} PL clocks"
            report(("clocks",), "too_many", message, "derive others in your static HDL")
    except BuildError as error:
        report(("project", "part"), "bad_value", str(error), "")
    for region in project.regions.values():
        _region(project, region, report)
        _fits(project, ("regions", region.name), region.resources, report)
    for module in project.modules.values():
        _module(project, module, report)
        _fits(project, ("modules", module.name), module.resources, report)
    _streams(project, report)
    if project.switch and project.switch.clock not in project.clocks:
        unknown(report, ("switch", "clock"), "clock", project.switch.clock, project.clocks)
    for mode in project.modes.values():
        _mode(project, mode, report)
    if project.default_mode not in project.modes:
        unknown(report, ("default_mode",), "mode", project.default_mode, project.modes)


def unknown(report: Report, key: KeyPath, kind: str, name: str, known: Iterable[str]) -> None:
    """Report a name that refers to nothing."""
    report(key, f"unknown_{kind}", f"there is no {kind} {name!r}", did_you_mean(name, known))


def _region(project: Project, region: RegionSpec, report: Report) -> None:
    key = ("regions", region.name)
    if region.clock not in project.clocks:
        unknown(report, (*key, "clock"), "clock", region.clock, project.clocks)
    for port, clock in region.clocks.items():
        if clock != "external" and clock not in project.clocks:
            unknown(report, (*key, "clocks", port), "clock", clock, (*project.clocks, "external"))
    if region.window & (region.window - 1):
        nearest = 1 << region.window.bit_length()
        report((*key, "window"), "bad_value", f"{region.window:#x} is not a power of two", f"write {nearest:#x}")
    for index, text in enumerate(region.pblock):
        _range(text, region.pblock, (*key, "pblock", index), report)
    if not project.modules_of(region.name):
        report(key, "unused", "no module goes to this region", "name it in a module's regions")


def _fits(project: Project, key: KeyPath, wanted: Resources, report: Report) -> None:
    """Check that resources are not more than the whole device has, where that is known."""
    try:
        device = device_of(project.part)
    except BuildError:
        return  # reported as the part
    have = Resources(*PARTS[device][:4]) if device in PARTS else wanted
    for name, most in zip(("lut", "ff", "bram", "dsp"), have.values(), strict=True):
        if getattr(wanted, name) > most:
            report((*key, "resources", name), "value_range", f"{getattr(wanted, name)} {name}", f"{device} has {most}")


def _range(text: str, ranges: tuple[str, ...], key: KeyPath, report: Report) -> None:
    """Check a range: it has two sites of one kind, the lower left one first."""
    if text == "auto":
        report(key, "bad_value", f"auto is combined with {len(ranges) - 1} ranges", "write auto alone, or ranges")
        return
    first, last = (_SITE.fullmatch(site) for site in (text.split(":")[0], text.split(":")[-1]))
    if first is None or last is None:  # reported by the JSON Schema
        return
    if first[1] != last[1]:
        report(key, "bad_value", f"{text} is from {first[1]} to {last[1]}", "both ends are sites of one kind")
    elif int(first[2]) > int(last[2]) or int(first[3]) > int(last[3]):
        left, right = (sorted((int(first[n]), int(last[n]))) for n in (2, 3))
        hint = f"write {first[1]}_X{left[0]}Y{right[0]}:{first[1]}_X{left[1]}Y{right[1]}"
        report(key, "bad_value", f"{text} does not begin at its lower left end", hint)


def _streams(project: Project, report: Report) -> None:
    """Check that each stream is one DMA channel."""
    switch = project.switch
    first = dict.fromkeys((*switch.inputs, *switch.outputs), "the switch") if switch else {}
    for name in switch.outputs if switch else ():
        if switch and name in switch.inputs:
            report(("switch", "outputs", name), "name_clash", f"{name} is an input too", "give each a name of its own")
    for region in project.regions.values():
        for name, spec in region.interfaces.items():
            here = f"{region.name}.{name}"
            if spec.stream is not None and first.setdefault(spec.stream, here) != here:
                key = ("regions", region.name, "interfaces", name, "stream")
                message = f"{spec.stream} is the stream of {first[spec.stream]} already"
                report(key, "name_clash", message, "each stream is one DMA channel: give it a name of its own")


def _module(project: Project, module: ModuleSpec, report: Report) -> None:
    key = ("modules", module.name)
    if not module.regions:
        hint = f"write regions: with some of {', '.join(project.regions)}"
        report(key, "missing_key", "with several regions, a module must say which of them it fits", hint)
    for index, region in enumerate(module.regions):
        if region not in project.regions:
            unknown(report, (*key, "regions", index), "region", region, project.regions)
    if not (module.sources or module.libraries or module.ip or module.tcl):
        report(key, "missing_key", "nothing to build it from", "give sources, core, ip or tcl")
    has_ports = bool(module.ip) and _lists_ports(module.ip[0])
    if module.ip and not (module.readable or module.component or has_ports):
        hint = "give component: (IP-XACT) or sim_sources: with a module of the same ports"
        report((*key, "ip"), "missing_key", "vendor IP cannot be parsed for its interfaces", hint)
    for register in module.registers.values():
        _register(register, (*key, "registers", register.name), report)
    _overlaps(module, key, report)


def _lists_ports(path: Path) -> bool:
    """Whether a file is an .xci of Vivado 2020.2 or newer; older ones have no ports."""
    return path.is_file() and path.read_text(encoding="utf-8", errors="replace").lstrip().startswith("{")


def _overlaps(module: ModuleSpec, key: KeyPath, report: Report) -> None:
    ordered = sorted(module.registers.values(), key=lambda register: register.offset)
    for one, other in pairwise(ordered):
        if other.offset < one.offset + one.width // 8:
            message = f"{other.name} overlaps {one.name}"
            hint = f"{one.name} is at {one.offset:#x}, {one.width} bits"
            report((*key, "registers", other.name), "overlapping_registers", message, hint)


def _register(register: Register, key: KeyPath, report: Report) -> None:
    if register.offset % (register.width // 8):
        message = f"offset {register.offset:#x} is not a multiple of {register.width // 8} bytes"
        report((*key, "offset"), "bad_alignment", message, "registers are aligned to their width")
    check_values(register, key, Context(report))
    check_fields(register, key, Context(report))


def _mode(project: Project, mode: ModeSpec, report: Report) -> None:
    if not project.modes_given:
        return
    key = ("modes", mode.name, "modules")
    for region, name in mode.modules.items():
        if region not in project.regions:
            unknown(report, (*key, region), "region", region, project.regions)
        elif name not in project.modules:
            unknown(report, (*key, region), "module", name, project.modules)
        elif region not in project.modules[name].regions:
            hint = f"it may go to {', '.join(project.modules[name].regions)}"
            report((*key, region), "region_conflict", f"{name} may not go to {region}", hint)
    if mode.routes and project.switch is None:
        report(("modes", mode.name, "routes"), "unknown_key", "there is no switch", "write switch: at the top")
    known = {
        register
        for name in mode.modules.values()
        if name in project.modules
        for register in project.modules[name].registers
    } | set(project.static.registers)
    for register in mode.registers:
        has_map = any(project.modules[name].register_maps for name in mode.modules.values() if name in project.modules)
        if register not in known and not has_map:
            unknown(report, ("modes", mode.name, "registers", register), "register", register, sorted(known))

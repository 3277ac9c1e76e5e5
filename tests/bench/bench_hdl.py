#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Measures interface extraction over checkouts of other people's HDL: python tests/bench/bench_hdl.py FOLDER…

Three figures. Yardstick: for every component.xml whose top module's HDL lies beside it, the AXI buses
that Vivado states against those extracted with the attributes blinded (by names alone) and with them:
exact port maps, protocols, buses that Vivado does not have. Parsing: files with a syntax error.
Time: CPU per file of a fresh extraction, imports and one warming run excluded.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from cm.design.hdl.detect import detect
from cm.design.hdl.errors import HdlError
from cm.design.hdl.extract import Sources, read
from cm.design.hdl.ipxact import load_component_xml
from cm.design.hdl.model import Interface, ModuleInfo, PortDirection

VERILOG = (".v", ".sv")
VHDL = (".vhd", ".vhdl")
AXI = ("axi4", "axi3", "axi4lite", "axis")


@dataclass
class Score:
    """What was counted for one language."""

    components: int = 0
    buses: int = 0
    exact: int = 0
    protocols: int = 0
    modes: int = 0
    clocks: int = 0
    clocks_stated: int = 0
    untold: int = 0
    skipped: int = 0
    spurious: int = 0
    signals: int = 0
    signals_stated: int = 0
    notes: list[str] = field(default_factory=list)


def main() -> int:
    """Run the measurements and print them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--no-time", action="store_true", help="skip parsing and timing of every file")
    parser.add_argument("-v", "--verbose", action="store_true", help="list every bus that differs and every bad file")
    arguments = parser.parse_args()
    for language, suffixes in (("Verilog", VERILOG), ("VHDL", VHDL)):
        for blind in (False, True):
            score = yardstick(arguments.folders, suffixes, blind=blind)
            report(f"{language}, {'names alone' if blind else 'attributes and names'}", score, arguments.verbose)
    if not arguments.no_time:
        for folder in arguments.folders:
            measure(folder, arguments.verbose)
    return 0


def extract(source: Path, name: str) -> ModuleInfo:
    """The module of that name."""
    return read(Sources([source], name, [source.parent])).modules[0]


def yardstick(folders: list[Path], suffixes: tuple[str, ...], *, blind: bool) -> Score:
    """Compare every component.xml with what is extracted from the HDL beside it; equal pairs count once."""
    score, seen = Score(), set()
    for path in (path for folder in folders for path in sorted(folder.rglob("component.xml"))):
        try:
            stated = load_component_xml(path)
        except HdlError as error:
            score.notes.append(f"unreadable: {error}")
            continue
        buses = [bus for bus in stated.interfaces if bus.protocol in AXI and bus.ports]
        source = find_top(path.parent, stated.name, suffixes)
        if not buses:
            continue
        if source is None:
            score.skipped += 1
            continue
        key = (stated.name, source.read_bytes(), tuple((b.name, tuple(b.ports.items())) for b in buses))
        if key in seen:
            continue
        seen.add(key)
        count(score, path, source, stated, buses, blind)
    return score


def find_top(folder: Path, name: str, suffixes: tuple[str, ...]) -> Path | None:
    """The file beside the component.xml that declares its top module."""
    declaration = re.compile(rb"\b(module|entity)\s+" + re.escape(name).encode() + rb"\b", re.IGNORECASE)
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in suffixes and path.is_file() and declaration.search(path.read_bytes()):
            return path
    return None


def count(score: Score, path: Path, source: Path, stated: ModuleInfo, buses: list[Interface], blind: bool) -> None:
    """Add one component to the score."""
    try:
        module = blinded(source, stated.name) if blind else extract(source, stated.name)
    except HdlError as error:
        score.notes.append(f"not extracted: {path}: {error}")
        score.buses += len(buses)
        return
    score.components += 1
    found = [bus for bus in module.interfaces if bus.protocol in AXI]
    for bus in buses:
        score.buses += 1
        match = next((f for f in found if same_ports(f, bus)), None)
        if match is None:
            score.notes.append(f"differs: {path}: {bus.name}: {difference(bus, found, module)}")
            continue
        score.exact += 1
        score.protocols += match.protocol == bus.protocol
        score.modes += match.mode is bus.mode
        if match.protocol != bus.protocol or match.mode is not bus.mode:
            score.notes.append(f"kind: {path}: {bus.name}: {match.protocol} {match.mode} for {bus.protocol} {bus.mode}")
        if bus.clock:
            score.clocks_stated += 1
            same = (match.clock or "").lower() == bus.clock.lower()
            score.clocks += same
            score.untold += match.clock is None
            if not same:
                score.notes.append(f"clock: {path}: {bus.name}: {match.clock} for {bus.clock}")
    count_signals(score, path, stated, module)
    taken = {port.lower() for bus in buses for port in bus.ports.values()}
    for bus in found:
        if not taken & {port.lower() for port in bus.ports.values()}:
            score.spurious += 1
            score.notes.append(f"spurious: {path}: {bus.name} ({bus.protocol})")


def count_signals(score: Score, path: Path, stated: ModuleInfo, module: ModuleInfo) -> None:
    """Clock and reset inputs (polarity too) and interrupt outputs that both the component.xml and the HDL have."""
    driven = {port.name.lower(): port.direction for port in module.ports}
    found = {(clock.port.lower(), "clock") for clock in module.clocks}
    found |= {(reset.port.lower(), str(reset.polarity)) for reset in module.resets}
    found |= {(line.port.lower(), "interrupt") for line in module.interrupts}
    wanted = [(clock.port.lower(), "clock", PortDirection.IN) for clock in stated.clocks]
    wanted += [(reset.port.lower(), str(reset.polarity), PortDirection.IN) for reset in stated.resets if reset.polarity]
    wanted += [(line.port.lower(), "interrupt", PortDirection.OUT) for line in stated.interrupts]
    for port, kind, direction in wanted:
        if driven.get(port) is direction:
            score.signals_stated += 1
            score.signals += (port, kind) in found
            if (port, kind) not in found:
                score.notes.append(f"signal: {path}: {port} is {kind}")


def blinded(source: Path, name: str) -> ModuleInfo:
    """The module without its X_INTERFACE attributes: what the names alone tell."""
    module = extract(source, name)
    bare = replace(module, ports=tuple(replace(port, attributes={}) for port in module.ports))
    return detect(replace(bare, interfaces=(), clocks=(), resets=(), interrupts=(), leftovers=()))


def same_ports(found: Interface, stated: Interface) -> bool:
    """Equal port maps; VHDL's case is not Vivado's."""
    lower = [{signal: port.lower() for signal, port in bus.ports.items()} for bus in (found, stated)]
    return lower[0] == lower[1]


def difference(bus: Interface, found: list[Interface], module: ModuleInfo) -> str:
    """Why there is no exact match, for a person."""
    ports = {port.lower() for port in bus.ports.values()}
    near = next((f for f in found if ports & {p.lower() for p in f.ports.values()}), None)
    if near is None:
        names = {port.name.lower() for port in module.ports}
        lacking = sorted(ports - names)
        return f"not found{f', the HDL has no {lacking}' if lacking else ''}"
    ours, theirs = set(near.ports.items()), set(bus.ports.items())
    return f"ours only {sorted(ours - theirs)}, Vivado's only {sorted(theirs - ours)}"


def report(title: str, score: Score, verbose: bool) -> None:
    """Print one score."""
    print(f"{title}: {score.components} components, {score.buses} AXI buses: {score.exact} exact port maps, ", end="")
    print(f"{score.protocols} protocols and {score.modes} modes right, {score.spurious} not in component.xml; ", end="")
    print(f"clock right for {score.clocks} of {score.clocks_stated} stated, ", end="")
    print(f"not told for {score.untold}; ", end="")
    print(f"{score.signals} of {score.signals_stated} clock and reset inputs and interrupt outputs; ", end="")
    print(f"{score.skipped} components whose top is not here in this language")
    for note in score.notes if verbose else ():
        print("   ", note)


def measure(folder: Path, verbose: bool) -> None:
    """Parse every file of the folder by itself; count syntax errors and CPU time."""
    for title, suffixes in (("Verilog", VERILOG), ("VHDL", VHDL)):
        times, bad, modules, empty = [], [], 0, 0
        for path in hdl_files(folder, suffixes):
            extract_one(path) if not times else None  # warm
            start = time.process_time()
            count_, problem = extract_one(path)
            times.append(1e3 * (time.process_time() - start))
            modules += count_
            empty += not count_
            if problem:
                bad.append(f"{path}: {problem}")
        if times:
            print(f"{folder.name}: {len(times)} {title} files, {modules} modules, ", end="")
            print(f"{empty} files without one, {len(bad)} with errors; CPU per file ", end="")
            print(f"mean {statistics.mean(times):.2f} ms, median {statistics.median(times):.2f} ms, ", end="")
            print(f"maximum {max(times):.1f} ms")
        for line in bad if verbose else ():
            print("   ", line)


def hdl_files(folder: Path, suffixes: tuple[str, ...]) -> Iterator[Path]:
    """All HDL files below, in order."""
    return (path for path in sorted(folder.rglob("*")) if path.suffix.lower() in suffixes and path.is_file())


def extract_one(path: Path) -> tuple[int, str]:
    """(number of modules, first syntax error) of one file by itself."""
    try:
        reading = read(Sources([path], include_dirs=[path.parent]))
    except HdlError as error:
        return 0, "" if "no module and no entity" in str(error) else str(error)
    syntax = [
        problem.message for module in reading.modules for problem in module.problems if is_syntax(problem.message)
    ]
    return len(reading.modules), syntax[0] if syntax else ""


def is_syntax(message: str) -> bool:
    """A message of the parser: expected …, not understood …, an include or macro that is missing."""
    return (
        message.startswith(("expected", "not understood", "unknown macro", "unexpected")) or "No such file" in message
    )


if __name__ == "__main__":
    raise SystemExit(main())

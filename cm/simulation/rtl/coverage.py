# SPDX-License-Identifier: Apache-2.0
"""Which lines of the HDL ran: what the harness has counted, as a table and for other tools (lcov's format)."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path

from cm.frozen import dataclass
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.tools import find_tools

INFO = "coverage.info"


@dataclass(frozen=True, slots=True)
class Covered:
    """A file of HDL: `counts` by line, of the lines that can run."""

    path: Path
    counts: Mapping[int, int]

    @property
    def ran(self) -> int:
        """Lines that ran at least once."""
        return sum(1 for count in self.counts.values() if count)

    @property
    def missed(self) -> tuple[int, ...]:
        """Lines that never ran."""
        return tuple(line for line, count in sorted(self.counts.items()) if not count)


def report(folder: Path) -> list[Covered]:
    """The coverage of all runs that have left their counts in a folder; writes ``coverage.info`` there.

    Files that `cm` writes only for the simulation, which are gone afterwards, are left out. Raises RtlError if nothing
    was counted.
    """
    counts = sorted(folder.glob("*.dat"))
    if not counts:
        raise RtlError(f"{folder} holds no counts: run `cm serve --sim=rtl --sim-coverage {folder}`")
    info = folder / INFO
    verilator = Path(find_tools().verilator)
    command = [str(verilator.with_name("verilator_coverage")), "--write-info", str(info), *map(str, counts)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode or not info.exists():
        raise RtlError(f"verilator_coverage cannot read {folder}: {(done.stderr or done.stdout).strip()[-500:]}")
    files = [one for one in _files(info.read_text(encoding="utf-8")) if one.path.exists()]
    info.write_text("".join(map(_as_info, files)), encoding="utf-8")
    return files


def table(files: list[Covered]) -> str:
    """A table for people: how many lines of each file ran, and where the others are."""
    width = max(len(one.path.name) for one in files) if files else 0
    lines = [
        f"{one.path.name:{width}}  {one.ran:4} of {len(one.counts):4} lines  {_ranges(one.missed)}".rstrip()
        for one in sorted(files, key=lambda one: str(one.path))
    ]
    ran, there = sum(one.ran for one in files), sum(len(one.counts) for one in files)
    return "\n".join([*lines, f"{ran} of {there} lines ran"])


def _files(info: str) -> Iterator[Covered]:
    for record in info.split("end_of_record"):
        path, counts = "", {}
        for line in record.splitlines():
            kind, _, rest = line.partition(":")
            if kind == "SF":
                path = rest
            elif kind == "DA":
                number, count = rest.split(",")[:2]
                counts[int(number)] = int(count)
        if path:
            yield Covered(Path(path), counts)


def _as_info(one: Covered) -> str:
    lines = "".join(f"DA:{line},{count}\n" for line, count in sorted(one.counts.items()))
    return f"TN:\nSF:{one.path}\n{lines}LH:{one.ran}\nLF:{len(one.counts)}\nend_of_record\n"


def _ranges(lines: tuple[int, ...]) -> str:
    found: list[list[int]] = []
    for line in lines:
        if found and line == found[-1][1] + 1:
            found[-1][1] = line
        else:
            found.append([line, line])
    return ("not: " if found else "") + ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in found)

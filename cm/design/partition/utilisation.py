# SPDX-License-Identifier: Apache-2.0
"""Finds Vivado's reports of ``report_utilization``, and reads resources from their text.

It reads the tables of 7 series (``Slice LUTs``) and UltraScale+ (``CLB LUTs``), for a module synthesised out of
context and for a whole design. Rows are found by name and columns by heading, because the number of columns
differs between versions.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from cm.design.errors import BuildError
from cm.design.partition.model import Part
from cm.design.parts import PARTS
from cm.design.project.model import Project, Resources
from cm.frozen import replace


def part_of(device: str) -> Part:
    """The part; BuildError lists those that are known."""
    if device not in PARTS:
        raise BuildError(f"the resources of {device} are not known here (only {', '.join(PARTS)})")
    lut, ff, bram, dsp, size = PARTS[device]
    return Part(device, Resources(lut, ff, bram, dsp), size)


_ROWS = {
    "Slice LUTs": "lut",
    "CLB LUTs": "lut",
    "Slice Registers": "ff",
    "CLB Registers": "ff",
    "Block RAM Tile": "bram",
    "DSPs": "dsp",
}


def read_utilisation(path: Path) -> Resources:
    """Return the resources used. Raises BuildError, with the file's name, if it is not such a report."""
    try:
        return parse_utilisation(path.read_text(encoding="utf-8", errors="replace"), str(path))
    except OSError as error:
        raise BuildError(f"{path}: {error.strerror}") from None


def parse_utilisation(text: str, name: str = "report") -> Resources:
    """Read a report's text; `name` is used in messages. For each row the first table that has it counts."""
    found: dict[str, float] = {}
    for site, used in _used(text):
        key = _ROWS.get(site)
        if key is not None and key not in found:
            found[key] = _number(used, site, name)
    missing = [wanted for wanted in dict.fromkeys(_ROWS.values()) if wanted not in found]
    if missing:
        wanted = {"lut": "LUTs", "ff": "registers", "bram": "Block RAM Tile", "dsp": "DSPs"}
        rows = ", ".join(wanted[key] for key in missing)
        raise BuildError(f"{name} is not a report of report_utilization: no row for {rows} (-hierarchical has none)")
    return Resources(int(found["lut"]), int(found["ff"]), found["bram"], int(found["dsp"]))


def _used(text: str) -> Iterator[tuple[str, str]]:
    """Yield (site type, used) of every row below a heading that has both."""
    column = 0
    for line in text.splitlines():
        if not line.startswith("|"):
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if cells[0] == "Site Type":
            column = cells.index("Used") if "Used" in cells else 0
        elif column and column < len(cells):
            # an asterisk refers to a note below the table
            yield cells[0].rstrip("*").rstrip(), cells[column]


def _number(text: str, site: str, name: str) -> float:
    if not re.fullmatch(r"\d+(\.\d+)?", text, re.ASCII):
        raise BuildError(f"{name}: {site}: {text!r} is not a number of sites used")
    return float(text)


def with_reports(project: Project, folders: Iterable[Path]) -> tuple[Project, dict[str, Path]]:
    """Return `project` with the resources in Vivado's reports, and the report that was read for each module.

    `resources:` in the build schema takes precedence. A module's report is that of the generated flow,
    ``synth_<module>.utilization.rpt``, or ``<module>.rpt``, in the first folder that has one.
    """
    listed = list(folders)
    modules, read = dict(project.modules), {}
    for name, spec in project.modules.items():
        names = (f"synth_{name}.utilization.rpt", f"{name}.utilization.rpt", f"{name}.rpt")
        path = next((folder / file for folder in listed for file in names if (folder / file).is_file()), None)
        if path is not None and not spec.resources:
            modules[name], read[name] = replace(spec, resources=read_utilisation(path)), path
    return replace(project, modules=modules), read


def static_report(folders: Iterable[Path]) -> Path | None:
    """The generated flow's report on the static part, in the first folder that has one."""
    paths = (folder / "static_synth.utilization.rpt" for folder in folders)
    return next((path for path in paths if path.is_file()), None)

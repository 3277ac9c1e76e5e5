# SPDX-License-Identifier: Apache-2.0
"""What a run says: results of the tests, and every report of the kernel about itself."""

from __future__ import annotations

import re
import tarfile
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

# Any of these in a kernel's log is a bug, of ours or of the kernel.
REPORTS = re.compile(
    "|".join(
        (
            r"\bBUG\b",
            r"\bWARNING: ",
            r"\bKASAN: ",
            r"\bUBSAN: ",
            r"\bKFENCE: ",
            r"possible (circular|recursive|irq lock)",
            r"inconsistent lock state",
            r"INFO: (task|rcu|trying to register)",
            r"suspicious RCU usage",
            r"DMA-API: (?!preallocated|debugging enabled)",
            r"ODEBUG: ",
            r"unreferenced object",
            r"kmemleak: (?!Kernel memory leak detector|Automatic memory scanning)",
            r"refcount_t: ",
            r"list_(add|del) corruption",
            r"Oops",
            r"Unable to handle kernel",
            r"Internal error: ",
            r"general protection fault",
            r"Kernel panic",
            r"Call [Tt]race:",
            r"sleeping function called",
            r"scheduling while atomic",
            r"OF: ERROR: ",
            r"deprecated workqueue",
        )
    )
)
# Loading modules that are not the kernel's own says this, and it is true.  So is what the kernel says of every overlay
# that exports labels: the properties of /__symbols__ stay allocated when it is taken away again, and of one that names
# the bitstream of a region that the board's own tree has.
EXPECTED = re.compile(
    r"loading out-of-tree module taints kernel|module verification failed"
    r"|OF: overlay: WARNING: memory leak will occur if overlay removed, property: "
    r"(/__symbols__/|/[a-z-]+-full/(firmware-name|partial-fpga-config)$)"
)


@dataclass(frozen=True, slots=True)
class Report:
    """One report of the kernel: its line number in the log, and the lines from there."""

    line: int
    text: str


@dataclass(frozen=True, slots=True)
class Results:
    """Counts over all JUnit files of a run, and the failures in words."""

    passed: int
    skipped: int
    failures: tuple[str, ...]
    reports: tuple[Report, ...]
    facts: dict[str, str]

    @property
    def good(self) -> bool:
        """Something was tested, and nothing went wrong."""
        return self.passed > 0 and not self.failures and not self.reports


def scan(log: str, context: int = 50) -> list[Report]:
    """Every report in a kernel's log; lines within `context` of one belong to it."""
    lines = log.splitlines()
    found: list[Report] = []
    last = -context - 1
    for number, line in enumerate(lines):
        if REPORTS.search(line) and not EXPECTED.search(line):
            if number - last > context:
                found.append(Report(number + 1, "\n".join(lines[number : number + context])))
            last = number
    return found


def collect(results: Path, console: Path, place: Path) -> Results:
    """Unpack what the board sent and count; a board that sent nothing has failed."""
    log = console.read_text(errors="replace") if console.exists() else ""
    reports = tuple(scan(log))
    if not results.exists() or not results.stat().st_size:
        tail = "\n".join(log.splitlines()[-20:])
        return Results(0, 0, (f"the board sent no results; end of its console:\n{tail}",), reports, {})
    folder = place / "results"
    with tarfile.open(results) as packed:
        if hasattr(tarfile, "data_filter"):  # Debian 12's Python 3.11.2 has none
            packed.extraction_filter = staticmethod(tarfile.data_filter)
        packed.extractall(folder)
    return _count(folder, reports)


def of_host(xml: Path, console: Path, status: int) -> Results:
    """The same for tests that ran on the host against a board."""
    reports = tuple(scan(console.read_text(errors="replace")))
    passed, skipped, failures = _cases([xml] if xml.exists() else [])
    if status and not failures:
        failures.append(f"the tests ended with status {status}, see {xml.with_name('pytest.log')}")
    return Results(passed, skipped, tuple(failures), reports, {"kernel": "from the host over TCP"})


def _cases(files: list[Path]) -> tuple[int, int, list[str]]:
    """How many passed, how many were skipped, and what failed and why."""
    passed = skipped = 0
    failures: list[str] = []
    for path in files:
        for case in ET.parse(path).iter("testcase"):
            outcome = {child.tag for child in case}
            name = f"{case.get('classname')}::{case.get('name')}"
            if outcome & {"failure", "error"}:
                failures.append(f"{name}\n{_explain(case)}")
            elif "skipped" in outcome:
                skipped += 1
            else:
                passed += 1
    return passed, skipped, failures


def _count(folder: Path, reports: tuple[Report, ...]) -> Results:
    passed, skipped, failures = _cases(sorted(folder.glob("*.xml")))
    facts = dict(line.split("=", 1) for line in (folder / "facts").read_text().splitlines() if "=" in line)
    if facts.get("status") != "0" and not failures:
        failures.append(f"the tests ended with status {facts.get('status')}, see output.log")
    leaks = folder / "kmemleak"
    if leaks.exists() and leaks.stat().st_size:
        reports = (*reports, *scan(leaks.read_text()))
    return Results(passed, skipped, tuple(failures), reports, facts)


def _explain(case: ET.Element) -> str:
    texts = [child.text or child.get("message") or "" for child in case if child.tag in {"failure", "error"}]
    return "\n".join(texts)

# SPDX-License-Identifier: Apache-2.0
"""Reports of files, cached by the state of a file's inode, never by its name.

A file that was replaced under the same name (PYNQ#1545) has another inode or another change time,
and is read again.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from pathlib import Path
from typing import TypeAlias

from cm.formats.bitstream.container import named, read_bitstream
from cm.formats.bitstream.inspect import inspect
from cm.formats.bitstream.inspection_report import Report
from cm.frozen import dataclass

InodeState: TypeAlias = "tuple[int, int, int, int, int]"
_TRIES = 3


@dataclass(frozen=True, slots=True)
class Inspected:
    """A file's bytes and the report of exactly those bytes."""

    data: bytes
    report: Report


def _state(file: int | Path) -> InodeState:
    found = os.stat(file)  # noqa: PTH116 (of a descriptor, too)
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


class ReportCache:
    """Reports of the most recently used `capacity` files. Not thread-safe; give each owner its own."""

    def __init__(self, capacity: int = 256) -> None:
        self._capacity = capacity
        self._kept: OrderedDict[InodeState, Report] = OrderedDict()

    def inspect(self, path: Path) -> Report:
        """Return the file's report, from the cache where its inode did not change since.

        Raises what `cm.formats.bitstream.inspect` raises.
        """
        return self.known(path) or self.read(path).report

    def known(self, path: Path) -> Report | None:
        """The report of a file that was inspected before and did not change since; raises OSError."""
        state = _state(path)
        report = self._kept.get(state)
        if report is not None:
            self._kept.move_to_end(state)
        return report

    def read(self, path: Path) -> Inspected:
        """Return the file's bytes with their report: what is loaded is then what was inspected."""
        for _ in range(_TRIES):
            with path.open("rb") as file:
                before = _state(file.fileno())
                with named(path):
                    data = read_bitstream(file)
                after = _state(file.fileno())
            if before == after and len(data) == before[2]:
                break
        else:
            return Inspected(data, inspect(data))  # a file that is still being written is not cached
        report = inspect(data)
        self._keep(before, report)
        return Inspected(data, report)

    def _keep(self, state: InodeState, report: Report) -> None:
        self._kept[state] = report
        if len(self._kept) > self._capacity:
            self._kept.popitem(last=False)

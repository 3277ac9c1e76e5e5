# SPDX-License-Identifier: Apache-2.0
"""Renames streams when regions change: each interface on a DMA engine has a stream with its own name."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from cm.design.boundary.analyse import Analysis
from cm.design.hdl.model import unique
from cm.design.project.model import ConnectionSpec, ModeSpec, Project

End = tuple[str, str]  # region, interface


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream and its frames."""

    name: str
    shape: tuple[int, ...] | None
    dtype: str

    def in_mode(self, mode: ModeSpec) -> Stream:
        """Return the stream with the frames that a mode gives it."""
        own = mode.streams.get(self.name)
        if own is None:
            return self
        return Stream(self.name, own.shape or self.shape, own.dtype or self.dtype)


def streams_of(project: Project, analysis: Analysis) -> dict[End, Stream]:
    """Every stream of `project` by its interface."""
    found = {}
    for region, boundary in analysis.boundaries.items():
        for interface in boundary.interfaces:
            spec = project.regions[region].interfaces.get(interface.name, ConnectionSpec())
            if interface.protocol == "axis" and spec.connect in (None, "dma", "vdma"):
                name = spec.stream or f"{region}_{interface.name}"
                found[region, interface.name] = Stream(name, spec.shape, spec.dtype)
    return found


class Streams:
    """The present streams, those of the regions that are `kept`, and those added for new regions."""

    def __init__(self, today: Mapping[End, Stream], kept: Iterable[str]) -> None:
        self._today = today
        names = set(kept)
        self._now = {end: stream for end, stream in today.items() if end[0] in names}
        self._moved: dict[tuple[str, End], End] = {}  # module and its present interface → new interface

    def connect(self, given: Mapping[str, Any] | None, before: End, now: End) -> dict[str, Any]:
        """Return the connection of the new interface `now`, made from that of `before` in the build schema."""
        spec = copy.deepcopy(dict(given or {}))
        old = self._today.get(before)
        if old is not None:
            taken = {stream.name for stream in self._now.values()}
            name = unique(old.name, taken)
            self._now[now] = Stream(name, old.shape, old.dtype)
            spec["stream"] = name
        return spec

    def move(self, module: str, before: End, now: End) -> None:
        """Record that `module` has its present interface `before` at `now`."""
        self._moved[module, before] = now

    def of_mode(self, mode: ModeSpec) -> dict[str, dict[str, Any]]:
        """Return the streams section of `mode`: frames that differ from those of the new streams."""
        found: dict[str, dict[str, Any]] = {}
        for before, old in self._today.items():
            now = self._now.get(self._moved.get((mode.modules.get(before[0], ""), before), before))
            wanted = old.in_mode(mode)
            if now is None:
                continue
            if wanted.shape and wanted.shape != now.shape:
                found.setdefault(now.name, {})["shape"] = list(wanted.shape)
            if wanted.shape and wanted.dtype != now.dtype:
                found.setdefault(now.name, {})["dtype"] = wanted.dtype
        return found

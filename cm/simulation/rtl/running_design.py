# SPDX-License-Identifier: Apache-2.0
"""The running logic: what is loaded where, and the receivers of the harness's events."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeAlias

from cm.frozen import dataclass
from cm.simulation.rtl.design import RtlDesign
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import HarnessProcess, Message, Op
from cm.simulation.software.hardware.logic import LogicParts
from cm.simulation.software.hardware.register_windows import Region

SLOT = 64 << 20  # bytes of the arena for each stream, and before them for everything else
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Library:
    """A compiled module. `folders`: where files are that its HDL reads."""

    path: Path
    folders: tuple[Path, ...] = ()

    @property
    def text(self) -> str:
        """As the harness takes it."""
        return "\n".join(map(str, (self.path, *self.folders)))


Libraries: TypeAlias = Callable[[Region], Library | None]  # what runs in a region now; None: nothing that is known


def of_modules(modules: Mapping[tuple[str, str], Library]) -> Libraries:
    """Libraries of modules, by region and name."""

    def found(region: Region) -> Library | None:
        if region.module is None or region.loading:
            return None
        library = modules.get((region.name, region.module.name))
        if library is None:
            _log.error("the design has no module %s for region %s", region.module.name, region.name)
        return library

    return found


class RunningDesign:
    """The harness and the regions of the fabric, kept alike."""

    def __init__(self, parts: LogicParts, design: RtlDesign, process: HarnessProcess, libraries: Libraries) -> None:
        self.design, self.process = design, process
        self._loop, self._libraries, self._seed = parts.loop, libraries, 1
        self._hears = False  # already asked to
        self._applied: dict[str, object] = dict.fromkeys(design.regions)
        self._runs: dict[str, Library] = {}  # what was loaded last, by region
        self._outputs = dict.fromkeys(design.outputs, 0)
        self.on_sent: dict[int, Callable[[], None]] = {}
        self.on_received: dict[int, Callable[[int, bool], None]] = {}
        self.on_interrupt: Callable[[bool], None] = lambda _: None
        self.traced = False
        self.stopped: dict[str, str] = {}  # regions whose module ended itself, and why
        parts.fabric.answering = self.follow
        parts.fabric.altered = self.again
        parts.fabric.resetting = self.reset

    def ask(self, op: Op, a: int = 0, b: int = 0, c: int = 0, d: int = 0, text: str = "") -> Message:
        """As `HarnessProcess.ask`; events that come meanwhile are handled soon."""
        answer = self.process.ask(op, a, b, c, d, text)
        if self.process.events and not self._hears:
            self._hears = True
            self._loop.call_soon(self.hear)
        return answer

    def output(self, region: str | None, name: str) -> int | None:
        """The value of a signal that leaves the device, by the module's name for it or its end; None: there is none."""
        for output, value in self._outputs.items():
            if output.region == region and (output.name == name or output.name.endswith(f"_{name}")):
                return value
        return None

    def hear(self) -> None:
        """Pass on what the harness has told."""
        self._hears = False
        for message in self.process.take():
            if message.op == Op.SENT:
                self.on_sent[message.a]()
            elif message.op == Op.RECEIVED:
                self.on_received[message.a](message.b, bool(message.c))
            elif message.op == Op.INTERRUPT:
                self.on_interrupt(bool(message.a))
            elif message.op == Op.OUTPUT:
                self._outputs[self.design.outputs[message.a]] = message.b
            elif message.op == Op.STOPPED:
                self._stop(self.design.regions[message.a], message.text)

    def mark(self, text: str) -> None:
        """Show a text in the trace, if one is written."""
        if self.traced:
            with contextlib.suppress(RtlError):
                self.ask(Op.MARK, text=text)

    def follow(self, region: Region) -> None:
        """A region has changed: it gives noise while it is written, then runs its module's library."""
        wanted: object = "loading" if region.loading else region.module
        number, before = self.design.regions.index(region.name), self._applied[region.name]
        if wanted is before:
            return
        self._applied[region.name] = wanted
        self.stopped.pop(region.name, None)
        self._seed += 1
        self.mark(f"{region.name}: {region.module.name if region.module else wanted or 'empty'}")
        library = self._libraries(region)
        if wanted == "loading":
            self._do(Op.UNDEFINE, number)
        elif library is not None:
            self._runs[region.name] = library
            self._do(Op.LOAD, number, library.text)
        elif before != "loading":
            self._do(Op.EMPTY, number)
        # else: a load that failed leaves the region as it was left: undefined

    def again(self, region: Region) -> None:
        """Bits have changed under a module: its library is that of the bits now. What it held is lost with that."""
        if self._applied[region.name] is not region.module or region.module is None:
            return
        library = self._libraries(region)
        if library is not None and library != self._runs.get(region.name):
            self._runs[region.name] = library
            self._do(Op.LOAD, self.design.regions.index(region.name), library.text)

    def reset(self) -> None:
        """As after power-up: the static part's registers too."""
        self._applied = dict.fromkeys(self._applied)
        for number in range(len(self._applied)):
            self._do(Op.EMPTY, number)
        self._do(Op.RESET)

    def _stop(self, region: str, why: str) -> None:
        self.stopped[region] = why
        _log.error("the module in region %s has ended: %s", region, why)

    def _do(self, op: Op, region: int = 0, text: str = "") -> None:
        try:
            answer = self.ask(op, region, self._seed, text=text)
        except RtlError as error:
            _log.error("%s", error)
            return
        if answer.a:
            _log.error("the logic refuses %s: %s", op.name.lower(), answer.text)

# SPDX-License-Identifier: Apache-2.0
"""A design that runs without a board around it: registers, modules and packets by hand, to test the logic alone."""

from __future__ import annotations

import json
import select
from pathlib import Path

from cm.simulation.rtl.compile import compile_harness
from cm.simulation.rtl.design import RtlDesign, wiring
from cm.simulation.rtl.errors import RtlError
from cm.simulation.rtl.process import HarnessProcess, Op
from cm.simulation.rtl.tools import Tools
from cm.wire.lazy_numpy import NDArray, np

_IN, _OUT = 64 << 20, 192 << 20  # places of the arena
_DECOUPLE, _IDENTITY = 0x100, 0x10C  # of the first region, in the control registers
_TRIES = 1000  # reads until a region is out of its reset
_PATIENCE = 120.0  # seconds in which the logic reports nothing


class HeadlessDesign:
    """The harness with a design whose first region has a stream each way.

    A context manager. Raises RtlError if the logic refuses.
    """

    def __init__(self, tools: Tools, design: RtlDesign, static: Path, folder: Path) -> None:
        """`static`: the compiled static part. `folder`: for the wiring."""
        (folder / "wiring").write_text(wiring(design, static, 1), encoding="utf-8")
        self._process = HarnessProcess(compile_harness(tools), folder / "wiring")
        self._streams = {end.sends: number for number, end in enumerate(design.streams)}
        self._control = design.system.control.base

    def __enter__(self) -> HeadlessDesign:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.close()

    @property
    def cycles(self) -> dict[str, int]:
        """Of each clock."""
        found: dict[str, int] = self._state()["cycles"]  # type: ignore[assignment]
        return found

    @property
    def cpu_seconds(self) -> float:
        """The processor time that the harness has used."""
        return float(str(self._state()["cpu_ns"])) / 1e9

    def write(self, address: int, value: int) -> None:
        """Write a word."""
        self._process.arena[:4] = value.to_bytes(4, "little")
        self._ask(Op.WRITE, address, 1, 0, 15)

    def read(self, address: int, words: int = 1) -> int:
        """Read a word `count` times; returns the first."""
        self._ask(Op.READ, address, words, 0)
        return int.from_bytes(self._process.arena[:4], "little")

    def load(self, library: Path) -> int:
        """Swap the region's module, cut off meanwhile; its identity, 0 where it does not come out of its reset."""
        self.write(self._control + _DECOUPLE, 1)
        self._ask(Op.LOAD, 0, 1, text=str(library))
        self.write(self._control + _DECOUPLE, 0)
        reads = (self.read(self._control + _IDENTITY) for _ in range(_TRIES))
        return next((identity for identity in reads if identity), 0)

    def through(self, data: bytes, room: int) -> NDArray[np.uint8]:
        """The packet that comes out when one goes in; `room` in bytes for it."""
        self._process.arena[_IN : _IN + len(data)] = data
        self._ask(Op.RECEIVE, self._streams[False], _OUT, room)
        self._ask(Op.SEND, self._streams[True], _IN, len(data))
        while True:
            for event in self._process.take():
                if event.op == Op.RECEIVED:
                    return np.frombuffer(self._process.arena[_OUT : _OUT + event.b], np.uint8)
            if not select.select([self._process], [], [], _PATIENCE)[0]:
                raise RtlError(f"nothing came out for {_PATIENCE:g} s")

    def _state(self) -> dict[str, object]:
        found: dict[str, object] = json.loads(self._process.ask(Op.STATE).text)
        return found

    def _ask(self, op: Op, a: int = 0, b: int = 0, c: int = 0, d: int = 0, text: str = "") -> None:
        answer = self._process.ask(op, a, b, c, d, text)
        if answer.a:
            raise RtlError(f"the logic refuses {op.name.lower()}: {answer.text or f'error {answer.a}'}")

# SPDX-License-Identifier: Apache-2.0
"""Interrupts by name: one UIO line each, or several names told apart by a status register."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from cm.daemon.loop import Loop
from cm.device import Root, Uio, find_uio
from cm.errors import CmError
from cm.manager.manager import Manager
from cm.messages.requests import RegWrite
from cm.messages.status import Irq
from cm.schema.model import Config, Interrupt

_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class _Line:
    """An open UIO device and the names that share it."""

    uio: Uio
    names: list[Interrupt]
    last: int | None = None


class Interrupts:
    """Waits on the lines of the loaded configuration and tells `on_irq`. The loop's thread."""

    def __init__(self, loop: Loop, root: Root, manager: Manager, on_irq: Callable[[Irq], None]) -> None:
        self._loop = loop
        self._root = root
        self._manager = manager
        self._on_irq = on_irq
        self._config: Config | None = None
        self._lines: dict[str, _Line] = {}
        self._last: dict[str, Irq] = {}

    @property
    def counts(self) -> dict[str, int]:
        """How often each came since the configuration was loaded."""
        return {name: irq.count for name, irq in self._last.items()}

    def latest(self, name: str) -> Irq:
        """Count and time of the last one; zero if none came."""
        return self._last.get(name, Irq(name, 0, 0))

    def watch(self, config: Config | None) -> None:
        """Watch the lines of a configuration; those that cannot be opened are tried again next time."""
        if config is not self._config:
            self.close()
            self._config, self._last = config, {}
        for interrupt in config.interrupts.values() if config else ():
            try:
                self._watch(interrupt)
            except (CmError, OSError) as error:
                _LOG.info("interrupt %s cannot be watched yet: %s", interrupt.name, error)

    def _watch(self, interrupt: Interrupt) -> None:
        node = interrupt.uio or find_uio(interrupt.base_address or 0, 4, self._root)[0].node
        line = self._lines.get(node)
        if line is None:
            uio = Uio.open(node, self._root)
            line = self._lines[node] = _Line(uio, [])
            uio.enable_interrupt()
            self._loop.add(uio.fileno(), lambda: self._fired(node))
        if interrupt not in line.names:
            line.names.append(interrupt)

    def _fired(self, node: str) -> None:
        line = self._lines[node]
        try:
            count = line.uio.take()
            if count is None:
                return
            new = 1 if line.last is None else (count - line.last) & 0xFFFFFFFF
            line.last = count
            self._tell(line, max(new, 1))
            line.uio.enable_interrupt()
        except OSError as error:
            _LOG.warning("interrupt line %s ended: %s", node, error)
            self._drop(node)

    def _tell(self, line: _Line, new: int) -> None:
        now = time.monotonic_ns()
        for interrupt in line.names:
            if interrupt.status is None or self._is_set(interrupt):
                irq = Irq(interrupt.name, self.latest(interrupt.name).count + new, now)
                self._last[interrupt.name] = irq
                self._on_irq(irq)

    def _is_set(self, interrupt: Interrupt) -> bool:
        """Read the status register; clear the bit if it is ours to clear."""
        try:
            value = self._manager.read_registers((interrupt.status or "",)).values[0].value
            bit = 1 << (interrupt.bit or 0)
            if value & bit and interrupt.acknowledge:
                self._manager.write_registers((RegWrite(interrupt.status or "", bit, bit),))
            return bool(value & bit)
        except CmError as error:
            _LOG.info("interrupt %s: its status cannot be read: %s", interrupt.name, error)
            return False

    def _drop(self, node: str) -> None:
        line = self._lines.pop(node, None)
        if line is not None:
            self._loop.remove(line.uio.fileno())
            line.uio.close()

    def close(self) -> None:
        """Stop watching."""
        for node in list(self._lines):
            self._drop(node)

# SPDX-License-Identifier: Apache-2.0
"""Interrupts by name: one UIO line each, or several names told apart by a status register.

The kernel masks a line when it fires (uio_pdrv_genirq), and it is unmasked here when its flags have been
acknowledged. A level that is still active would fire again at once: a line that cannot be acknowledged now stays
masked, and is tried again.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable

from cm.device import Root, Uio, find_uio
from cm.errors import CmError
from cm.frozen import dataclass, field
from cm.manager.manager import Manager
from cm.schema.model import Config, Interrupt
from cm.server.error_replies import error_info
from cm.server.sockets import Loop
from cm.wire.messages.status import ErrorInfo, Irq

_LOG = logging.getLogger(__name__)
_RETRY = 0.25  # seconds until a masked line is tried again; the end of a change tries it at once


@dataclass(slots=True)
class _Line:
    """An open UIO device and the names that share it."""

    uio: Uio
    names: list[Interrupt]
    last: int | None = None
    new: int = 0  # interrupts since the one before
    waiting: deque[list[Interrupt]] = field(default_factory=deque)  # fired, not looked at yet: by status register
    reported: bool = False  # that it stays masked


class InterruptWatch:
    """Waits on the lines of the loaded configuration and tells `on_irq`. The loop's thread."""

    def __init__(
        self,
        loop: Loop,
        root: Root,
        manager: Manager,
        on_irq: Callable[[Irq], None],
        on_error: Callable[[ErrorInfo], None],
    ) -> None:
        self._loop = loop
        self._root = root
        self._manager = manager
        self._on_irq = on_irq
        self._on_error = on_error
        self.config: Config | None = None  # that is watched
        self.incomplete = True  # a line is not open, or masked: `watch` tries again
        self._lines: dict[str, _Line] = {}
        self._last: dict[str, Irq] = {}
        self._retrying = False

    @property
    def counts(self) -> dict[str, int]:
        """How often each interrupt came since the configuration was loaded."""
        return {name: irq.count for name, irq in self._last.items()}

    def latest(self, name: str) -> Irq:
        """Count and time of the last one; zero if none came."""
        return self._last.get(name, Irq(name, 0, 0))

    def watch(self, config: Config | None) -> None:
        """Watch the lines of a configuration; what could not be opened or acknowledged before is tried again."""
        if config is not self.config:
            self.close()
            self.config, self._last = config, {}
        self.incomplete = False
        for interrupt in config.interrupts.values() if config else ():
            try:
                self._watch_line(interrupt)
            except (CmError, OSError) as error:
                self.incomplete = True
                _LOG.info("interrupt %s cannot be watched yet: %s", interrupt.name, error)
        for node, line in list(self._lines.items()):
            if line.waiting:  # masked
                self._serve(node, line)

    def _watch_line(self, interrupt: Interrupt) -> None:
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
        except OSError as error:
            self._end(node, error)
            return
        if count is None:
            return
        line.new = 1 if line.last is None else max((count - line.last) & 0xFFFFFFFF, 1)
        line.last = count
        sharing: dict[str | None, list[Interrupt]] = {}  # a status register: it is read and acknowledged once for all
        for interrupt in line.names:
            sharing.setdefault(interrupt.status, []).append(interrupt)
        line.waiting = deque(sharing.values())
        self._serve(node, line)

    def _serve(self, node: str, line: _Line) -> None:
        """Report the interrupts that came, acknowledge, and unmask; a line that cannot be acknowledged stays masked."""
        try:
            while line.waiting:
                self._report(line.waiting[0], line.new)
                line.waiting.popleft()
        except (CmError, OSError) as error:
            self._keep_masked(line, error)
            return
        line.reported = False
        try:
            line.uio.enable_interrupt()
        except OSError as error:
            self._end(node, error)

    def _report(self, sharing: list[Interrupt], new: int) -> None:
        """Report those of one status register that came, after acknowledging them. Raises CmError, OSError."""
        now, status = time.monotonic_ns(), sharing[0].status
        ours = sum({1 << (interrupt.bit or 0) for interrupt in sharing if interrupt.acknowledge})
        value = self._manager.registers.take_flags(status, ours) if status is not None else 0
        for interrupt in sharing:
            if status is None or value >> (interrupt.bit or 0) & 1:
                irq = Irq(interrupt.name, self.latest(interrupt.name).count + new, now)
                self._last[interrupt.name] = irq
                self._on_irq(irq)

    def _keep_masked(self, line: _Line, error: Exception) -> None:
        """Report this once; not while a change runs, since its end is awaited as for any access to its regions."""
        self.incomplete = True
        names = ", ".join(interrupt.name for interrupt in line.waiting[0])
        if not line.reported and not self._manager.changing:
            line.reported = True
            said = f"interrupt {names} is masked until it can be acknowledged: {error}"
            self._on_error(ErrorInfo(error_info(error).code, said))
        self._retry_later()

    def _retry_later(self) -> None:
        if not self._retrying:
            self._retrying = True
            self._loop.call_later(_RETRY, self._retry)

    def _retry(self) -> None:
        self._retrying = False
        self.watch(self.config)

    def _end(self, node: str, error: OSError) -> None:
        """Its device has gone, as with an overlay; look again in case another overlay brings one."""
        _LOG.warning("interrupt line %s ended: %s", node, error)
        self.incomplete = True
        self._drop(node)
        self._retry_later()

    def _drop(self, node: str) -> None:
        line = self._lines.pop(node, None)
        if line is not None:
            self._loop.remove(line.uio.fileno())
            line.uio.close()

    def close(self) -> None:
        """Stop watching."""
        for node in list(self._lines):
            self._drop(node)

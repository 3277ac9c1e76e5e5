# SPDX-License-Identifier: Apache-2.0
"""Clocks of the processing system for the PL, as our kernel module cm_clock shows them in sysfs."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterable, Mapping

from cm.schema.clock_rates import PLL, rounded
from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.nodes.attributes import AttributeNode
from cm.simulation.software.transport.root import Root
from cm.simulation.software.transport.server import Server

BASE = "sys/class/cm_clock"
_BOOT = 50_000_000  # Hz, as a boot loader may leave it


class Clocks:
    """One folder for each clock: ``rate``, ``round`` and ``enable``. Setting rounds down without an error."""

    def __init__(self, root: Root, names: Iterable[str], family: str, faults: Faults) -> None:
        self._root, self._faults, self._pll = root, faults, PLL[family]
        self.rates = {name: rounded(self._pll, _BOOT) for name in sorted(names)}
        self._enabled = dict.fromkeys(self.rates, 0)
        self._rounded = dict.fromkeys(self.rates, 0)

    def serve(self, server: Server) -> None:
        """Make the folders and listen."""
        for name in self.rates:
            self._listen(server, f"{name}/rate", self._reader(self.rates, name), self._setter(name))
            self._listen(server, f"{name}/round", self._reader(self._rounded, name), self._rounder(name))
            self._listen(server, f"{name}/enable", self._reader(self._enabled, name), self._gate(name))

    def _listen(self, server: Server, path: str, read: Callable[[], bytes], write: Callable[[bytes], None]) -> None:
        server.listen(self._root.bind(f"{BASE}/{path}"), AttributeNode(read, write))

    def _reader(self, values: Mapping[str, int], name: str) -> Callable[[], bytes]:
        def read() -> bytes:
            return f"{values[name]}\n".encode()

        return read

    def _setter(self, name: str) -> Callable[[bytes], None]:
        def write(data: bytes) -> None:
            wanted = _number(data)
            if not self._faults.take("clock_stuck", name):
                self.rates[name] = rounded(self._pll, wanted)

        return write

    def _rounder(self, name: str) -> Callable[[bytes], None]:
        def write(data: bytes) -> None:
            self._rounded[name] = rounded(self._pll, _number(data))

        return write

    def _gate(self, name: str) -> Callable[[bytes], None]:
        def write(data: bytes) -> None:
            self._enabled[name] = _number(data, 1)

        return write


def _number(data: bytes, most: int = (1 << 64) - 1) -> int:
    """Raises NodeError (EINVAL) as kstrtoul does."""
    text = data.decode("ascii", "replace").strip()
    if not text.isdigit() or int(text) > most:
        raise NodeError(errno.EINVAL, f"{text!r} is not a number up to {most}")
    return int(text)

# SPDX-License-Identifier: Apache-2.0
"""Clocks of the processing system for the PL, as our kernel module cm_clock shows them in sysfs."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Mapping
from functools import partial

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
            for file, values, write in (
                ("rate", self.rates, self._set),
                ("round", self._rounded, self._round),
                ("enable", self._enabled, self._gate),
            ):
                node = AttributeNode(partial(_shown, values, name), partial(write, name))
                server.listen(self._root.bind(f"{BASE}/{name}/{file}"), node)

    def _set(self, name: str, data: bytes) -> None:
        wanted = _number(data)
        if not self._faults.take("clock_stuck", name):
            self.rates[name] = rounded(self._pll, wanted)

    def _round(self, name: str, data: bytes) -> None:
        self._rounded[name] = rounded(self._pll, _number(data))

    def _gate(self, name: str, data: bytes) -> None:
        self._enabled[name] = _number(data, 1)


def _shown(values: Mapping[str, int], name: str) -> bytes:
    return f"{values[name]}\n".encode()


def _number(data: bytes, most: int = (1 << 64) - 1) -> int:
    """Raises NodeError (EINVAL) as kstrtoul does."""
    text = data.decode("ascii", "replace").strip()
    if not text.isdigit() or int(text) > most:
        raise NodeError(errno.EINVAL, f"{text!r} is not a number up to {most}")
    return int(text)

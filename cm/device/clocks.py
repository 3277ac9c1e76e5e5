# SPDX-License-Identifier: Apache-2.0
"""Clocks of the processing system for the PL: our module cm_clock, or linux-xlnx's driver of xlnx,fclk."""

from __future__ import annotations

import errno
import re
from collections.abc import Iterator

from cm.device import advice
from cm.device.attributes import Attributes
from cm.device.base import AnyRoot
from cm.device.errors import DeviceError, DeviceNotFound
from cm.device.paths import Root

CLASS = "sys/class/cm_clock"
FCLK = "sys/bus/platform/drivers/xilinx_fclk"
# One clock has several names: in a .hwh and in device trees of either family.
_NUMBERED = re.compile(r"(?:fclk|fclk_clk|pl|pl_clk|clocking)_?([0-3])")


class PlClock:
    """One clock.  Stateless: the kernel keeps the rate, also when we end.

    Rates are rounded as the clock's dividers require, mostly down, without an error: read back what was set.
    """

    def __init__(self, name: str, attributes: Attributes, rate: str) -> None:
        """Made by `PlClocks.find`; `rate` is the name of the attribute that holds the rate."""
        self.name = name
        self._attributes = attributes
        self._rate = rate

    @property
    def rate(self) -> int:
        """The rate at which it runs, in Hz."""
        return self._number(self._rate)

    @rate.setter
    def rate(self, hertz: int) -> None:
        self._attributes.write(self._rate, f"{hertz}\n".encode())

    def rounded(self, hertz: int) -> int | None:
        """The rate at which it would run if set to `hertz`; None if the driver cannot tell without setting it."""
        if not self._attributes.exists("round"):
            return None
        self._attributes.write("round", f"{hertz}\n".encode())
        return self._number("round") or None

    @property
    def enabled(self) -> bool:
        """Whether it is kept running; a driver without a gate keeps it running while it is bound."""
        return not self._attributes.exists("enable") or self._number("enable") != 0

    @enabled.setter
    def enabled(self, on: bool) -> None:
        if self._attributes.exists("enable"):
            self._attributes.write("enable", b"1\n" if on else b"0\n")

    def _number(self, name: str) -> int:
        text = self._attributes.text(name)
        try:
            return int(text)
        except ValueError:
            path = self._attributes.path(name)
            raise DeviceError(errno.EIO, f"{path} reads {text!r}, which is not a number", path) from None


class PlClocks:
    """The clocks of a board."""

    def __init__(self, root: AnyRoot = None) -> None:
        """Nothing is opened or checked here."""
        self._root = Root.of(root)

    def names(self) -> list[str]:
        """The names of all clocks that can be set, sorted; none without a driver."""
        return sorted(name for name, _ in self._all())

    def find(self, name: str) -> PlClock:
        """A clock by its name, or by another name of the same PL clock (fclk0, pl0, pl_clk0, clocking0).

        Raises DeviceNotFound with the clocks that there are.
        """
        clocks = dict(self._all())
        found = clocks.get(name) or next((clock for other, clock in clocks.items() if _same(other, name)), None)
        if found is None:
            there = f"there are {', '.join(sorted(clocks))}" if clocks else "there are none"
            text = (
                f"no clock {name!r} can be set on this board; {there}. Load module cm_clock with a node "
                "compatible with fpga-cm,clocks that names it, or use linux-xlnx with an xlnx,fclk node"
            )
            raise DeviceNotFound(errno.ENOENT, text, str(self._root.join(CLASS)))
        return found

    def _all(self) -> Iterator[tuple[str, PlClock]]:
        for name in advice.names(self._root.join(FCLK)):
            if self._root.join(FCLK, name, "set_rate").exists():
                short = name.rpartition(":")[2]  # below a bus, a node's device is called bus:node
                yield short, PlClock(short, Attributes(self._root, f"{FCLK}/{name}"), "set_rate")
        for name in advice.names(self._root.join(CLASS)):
            yield name, PlClock(name, Attributes(self._root, f"{CLASS}/{name}"), "rate")


def _same(one: str, other: str) -> bool:
    first, second = _NUMBERED.fullmatch(one), _NUMBERED.fullmatch(other)
    return first is not None and second is not None and first[1] == second[1]

# SPDX-License-Identifier: Apache-2.0
"""The one board of a program, as PYNQ's calls name none; its interrupts, awaited, and its clocks."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import cache
from typing import Any

from cm.client.board import Board, connect
from cm.client.places import Places
from cm.errors import Timeout

_SLICE = 0.25  # seconds that a thread waits before it looks whether anybody still wants it to


@cache
def board() -> Board:
    """The board, connected at the first use: that of `$CM_CONNECT`, or of this machine."""
    return connect()


@cache
def places() -> Places:
    """The words of the board."""
    return Places(board())


class Interrupt:
    """The interrupt of a pin, such as ``"filter/interrupt"``; whether there is one is checked when it is awaited."""

    def __init__(self, pinname: str) -> None:
        self._name = pinname.replace("/", "_").lower()

    async def wait(self) -> None:
        """Until it comes; one that came since this program's last wait counts. Raises RequestNotFound."""
        while not await asyncio.get_running_loop().run_in_executor(None, self._came):
            pass

    def _came(self) -> bool:
        with suppress(Timeout):
            board().interrupts[self._name].wait(_SLICE)
            return True
        return False


class _Clocks:
    """``Clocks.fclk0_mhz`` and so on, in MHz. Setting one raises NotImplementedError."""

    def __getattr__(self, name: str) -> float:
        for clock in board().status.clocks if name.endswith("_mhz") else ():
            if name in (f"{clock.name}_mhz", f"{clock.name}_mhz".replace("pl", "fclk")):  # as PYNQ's on any device
                return (clock.rate or clock.wanted) / 1e6
        raise AttributeError(f"the loaded configuration has no {name!r}, of fclk0_mhz to fclk3_mhz")

    def __setattr__(self, name: str, value: Any) -> None:
        raise NotImplementedError(
            f"Clocks.{name} = {value}: a rate belongs to the configuration (`clocks:` of its schema), which sets it "
            "with each load"
        )


Clocks = _Clocks()

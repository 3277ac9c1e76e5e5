# SPDX-License-Identifier: Apache-2.0
"""`Interrupt`: awaited, as in PYNQ."""

from __future__ import annotations

import asyncio
from contextlib import suppress

from cm.errors import Timeout
from cm.pynq.board import board

_SLICE = 0.25  # seconds that a thread waits before it looks whether anybody still wants it to


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

# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: `connect()` gives a `Board` whose methods are those of `cm.connect()`, awaited.

    async with cm.aio.connect() as board:
        await board.load("camera", mode="default")
        await board.registers.write({"focus": 2})
        async for frame in board.stream("camera"):
            ...

What is a property there is a method here: ``await board.status()``, ``await board.mode()``. Assignment to
properties and brackets is the blocking client's only extra; here it is ``await board.set_mode(…)`` and
``await board.registers.write({…})``.
"""

from __future__ import annotations

from cm.client.aio.board import Board, connect

__all__ = ["Board", "connect"]

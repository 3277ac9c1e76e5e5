# SPDX-License-Identifier: Apache-2.0
"""The asyncio client: `connect()` gives a `Board` whose methods are those of `cm.connect()`, awaited.

    async with cm.aio.connect() as board:
        await board.load("camera", mode="default")
        await board.registers.write({"focus": 2})
        async for frame in board.stream("camera"):
            ...

Properties of the blocking client are methods here: ``await board.status()``, ``await board.mode()``. Only the
blocking client has assignment to properties and brackets; here it is ``await board.set_mode(…)`` and
``await board.registers.write({…})``.
"""

from __future__ import annotations

from cm.client.aio.board import Board, connect

__all__ = ["Board", "connect"]

# SPDX-License-Identifier: Apache-2.0
"""Memories of the asyncio client: ``await board.memories["coefficients"].write(array)``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cm.client.core import calls, memory
from cm.wire.messages.status import MemoryInfo

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller
    from cm.client.core.memory import Array, Key


class Memory:
    """As `cm.client.memories.Memory`, awaited."""

    def __init__(self, board: Caller, name: str) -> None:
        self._board = board
        self.name = name

    async def info(self) -> MemoryInfo:
        """What the manager knows about it."""
        return await self._board.ask(memory.describe(self.name))

    async def read(self, offset: int = 0, length: int | None = None) -> Array:
        """A copy of `length` bytes (None: the rest), as an array of the memory's dtype."""
        return await self._board.run(memory.read(self.name, offset, length))

    async def write(self, data: Any, offset: int = 0, lease: str = "") -> int:
        """Write values as elements of the memory, or plain bytes; returns how many bytes were written."""
        return await self._board.run(memory.write(self.name, data, offset, lease))

    async def get(self, key: Key) -> Any:
        """A row, or rows, of the first axis; reads no more than it needs."""
        return await self._board.run(memory.get(self.name, key))

    async def put(self, key: Key, value: Any, lease: str = "") -> None:
        """Write rows of the first axis; together they must be whole words of 32 bits."""
        await self._board.run(memory.put(self.name, key, value, lease))

    if not TYPE_CHECKING:  # for a type checker they would allow all

        def __getitem__(self, key: Key) -> Any:
            raise TypeError(f"await board.memories[{self.name!r}].get({key!r}): brackets cannot be awaited")

        def __setitem__(self, key: Key, value: Any) -> None:
            raise TypeError(f"await board.memories[{self.name!r}].put({key!r}, …): an assignment cannot be awaited")

    def __repr__(self) -> str:
        return f"<Memory {self.name}>"


class Memories:
    """Memories of the current mode by name."""

    def __init__(self, board: Caller) -> None:
        self._board = board

    def __getitem__(self, name: str) -> Memory:
        """The memory of that name; whether it exists is checked when it is used."""
        return Memory(self._board, name)

    async def info(self) -> dict[str, MemoryInfo]:
        """What the manager knows about each memory of the current mode."""
        return memory.visible(await self._board.ask(calls.describe()))

    def __repr__(self) -> str:
        return f"<memories of {self._board!r}>"

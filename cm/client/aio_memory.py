# SPDX-License-Identifier: Apache-2.0
"""Memories of the asyncio client: ``await board.memories["coefficients"].write(array)``."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator
from typing import Any, TypeVar

from cm.client import memory
from cm.client.calls import Call
from cm.client.memory import Array, Key
from cm.messages.status import ConfigInfo, MemoryInfo

_T = TypeVar("_T")
Ask = Callable[[Call[Any]], Awaitable[Any]]


async def _run(ask: Ask, wanted: Generator[Call[Any], Any, _T]) -> _T:
    result: Any = None
    while True:
        try:
            call = wanted.send(result)
        except StopIteration as end:
            value: _T = end.value
            return value
        result = await ask(call)


class Memory:
    """As `cm.client.memories.Memory`, awaited."""

    def __init__(self, ask: Ask, name: str) -> None:
        self._ask = ask
        self.name = name

    async def info(self) -> MemoryInfo:
        """What the manager knows of it."""
        info: MemoryInfo = await self._ask(memory.describe(self.name))
        return info

    async def read(self, offset: int = 0, length: int | None = None) -> Array:
        """A copy of `length` bytes (None: the rest), as an array of the memory's dtype."""
        return await _run(self._ask, memory.read(self.name, offset, length))

    async def write(self, data: Any, offset: int = 0, lease: str = "") -> int:
        """Write values as the memory's elements, or bytes as they are; returns how many bytes they were."""
        return await _run(self._ask, memory.write(self.name, data, offset, lease))

    async def get(self, key: Key) -> Any:
        """A row, or rows, of the first axis; no more is read than it needs."""
        return await _run(self._ask, memory.get(self.name, key))

    async def put(self, key: Key, value: Any, lease: str = "") -> None:
        """Write rows of the first axis; together they must be whole words of 32 bits."""
        await _run(self._ask, memory.put(self.name, key, value, lease))


class Memories:
    """Memories of the current mode by name."""

    def __init__(self, ask: Ask, config: Callable[[], Awaitable[ConfigInfo]]) -> None:
        self._ask = ask
        self._config = config

    def __getitem__(self, name: str) -> Memory:
        """The memory of that name; whether there is one shows when it is used."""
        return Memory(self._ask, name)

    async def info(self) -> dict[str, MemoryInfo]:
        """What the manager knows of each that can be named now."""
        config = await self._config()
        return {m.name: m for m in config.memories if not m.modes or config.mode in m.modes}

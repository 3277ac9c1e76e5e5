# SPDX-License-Identifier: Apache-2.0
"""Memories of the blocking client: ``board.memories["coefficients"].write(array)``."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any, TypeVar

from cm.client import memory
from cm.client.calls import Call
from cm.client.memory import Array, Key
from cm.messages.status import ConfigInfo, MemoryInfo

_T = TypeVar("_T")
Ask = Callable[[Call[Any]], Any]


def _run(ask: Ask, wanted: Generator[Call[Any], Any, _T]) -> _T:
    result: Any = None
    while True:
        try:
            call = wanted.send(result)
        except StopIteration as end:
            value: _T = end.value
            return value
        result = ask(call)


class Memory:
    """A memory; nothing of it is kept here. Offsets and lengths are bytes, multiples of 4."""

    def __init__(self, ask: Ask, name: str) -> None:
        self._ask = ask
        self.name = name

    @property
    def info(self) -> MemoryInfo:
        """What the manager knows of it."""
        info: MemoryInfo = self._ask(memory.describe(self.name))
        return info

    def read(self, offset: int = 0, length: int | None = None) -> Array:
        """A copy of `length` bytes (None: the rest), as an array of the memory's dtype.

        The whole comes in the memory's shape. Parts are arrays of one axis; those that are no whole elements
        are uint8. Raises RequestFailed.
        """
        return _run(self._ask, memory.read(self.name, offset, length))

    def write(self, data: Any, offset: int = 0, lease: str = "") -> int:
        """Write values as the memory's elements, or bytes as they are; returns how many bytes they were.

        `lease`: the id of one's own, where the memory or its region is held. Raises InvalidRequest for values that
        its dtype cannot hold, RequestFailed.
        """
        return _run(self._ask, memory.write(self.name, data, offset, lease))

    def __len__(self) -> int:
        """Length of the first axis."""
        return memory.shape_of(self.info)[0]

    def __getitem__(self, key: Key) -> Any:
        """A row, or rows, of the first axis: what `read()[key]` has, but no more is read than it needs."""
        return _run(self._ask, memory.get(self.name, key))

    def __setitem__(self, key: Key, value: Any) -> None:
        """Write rows of the first axis; together they must be whole words of 32 bits."""
        _run(self._ask, memory.put(self.name, key, value))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """The whole, for ``numpy.asarray(memory)``."""
        if copy is False:
            raise ValueError(f"memory {self.name!r} cannot be had without a copy")
        array = self.read()
        return array if dtype is None else array.astype(dtype)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.read())

    def __repr__(self) -> str:
        return f"<Memory {self.name}>"


class Memories(Mapping[str, Memory]):
    """Memories of the current mode by name."""

    def __init__(self, ask: Ask, config: Callable[[], ConfigInfo]) -> None:
        self._ask = ask
        self._config = config

    def __getitem__(self, name: str) -> Memory:
        """The memory of that name; whether there is one shows when it is used."""
        return Memory(self._ask, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.info)

    def __len__(self) -> int:
        return len(self.info)

    def __contains__(self, name: object) -> bool:
        return name in self.info

    @property
    def info(self) -> dict[str, MemoryInfo]:
        """What the manager knows of each that can be named now."""
        config = self._config()
        return {m.name: m for m in config.memories if not m.modes or config.mode in m.modes}

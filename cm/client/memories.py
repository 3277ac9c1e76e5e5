# SPDX-License-Identifier: Apache-2.0
"""Memories of the blocking client: ``board.memories["coefficients"].write(array)``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from cm.client.core import calls, memory
from cm.wire.messages.status import MemoryInfo

if TYPE_CHECKING:
    from cm.client.core.memory import Array, Key
    from cm.client.request_reply import Caller


class Memory:
    """A memory; its content is not cached. Offsets and lengths are in bytes, multiples of 4."""

    def __init__(self, board: Caller, name: str) -> None:
        self._board = board
        self.name = name

    @property
    def info(self) -> MemoryInfo:
        """What the manager knows about it."""
        return self._board.ask(memory.describe(self.name))

    def read(self, offset: int = 0, length: int | None = None) -> Array:
        """A copy of `length` bytes (None: the rest), as an array of the memory's dtype.

        The whole memory has the memory's shape. Parts are arrays of one axis; parts that are not whole elements
        are uint8. Raises RequestFailed.
        """
        return self._board.run(memory.read(self.name, offset, length))

    def write(self, data: Any, offset: int = 0, lease: str = "") -> int:
        """Write values as elements of the memory, or plain bytes; returns how many bytes were written.

        `lease`: your lease's id, if the memory or its region is under a lease. Raises InvalidRequest for values that
        its dtype cannot hold, RequestFailed.
        """
        return self._board.run(memory.write(self.name, data, offset, lease))

    def get(self, key: Key) -> Any:
        """A row, or rows, of the first axis; reads no more than it needs."""
        return self._board.run(memory.get(self.name, key))

    def put(self, key: Key, value: Any, lease: str = "") -> None:
        """Write rows of the first axis; together they must be whole words of 32 bits."""
        self._board.run(memory.put(self.name, key, value, lease))

    def __len__(self) -> int:
        """Length of the first axis."""
        return memory.shape_of(self.info)[0]

    def __getitem__(self, key: Key) -> Any:
        """A row, or rows, of the first axis, like `read()[key]`, but reads no more than it needs."""
        return self.get(key)

    def __setitem__(self, key: Key, value: Any) -> None:
        """Write rows of the first axis; together they must be whole words of 32 bits."""
        self.put(key, value)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """The whole memory, for ``numpy.asarray(memory)``."""
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

    def __init__(self, board: Caller) -> None:
        self._board = board

    def __getitem__(self, name: str) -> Memory:
        """The memory of that name; whether it exists is checked when it is used."""
        return Memory(self._board, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.info)

    def __len__(self) -> int:
        return len(self.info)

    def __contains__(self, name: object) -> bool:
        return name in self.info

    @property
    def info(self) -> dict[str, MemoryInfo]:
        """What the manager knows about each memory of the current mode."""
        config = self._board.ask(calls.describe())
        return memory.visible(config)

    def __repr__(self) -> str:
        return f"<memories of {self._board!r}>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.info)

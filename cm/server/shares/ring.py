# SPDX-License-Identifier: Apache-2.0
"""What waits, by its owner: owners take turns, and what one of them has waiting comes in order."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import Generic, TypeVar

_K = TypeVar("_K", bound=Hashable)
_T = TypeVar("_T")


class Ring(Generic[_K, _T]):
    """Round robin among owners, however much each of them has waiting."""

    def __init__(self) -> None:
        self._lines: dict[_K, deque[_T]] = {}  # in the order in which they come next

    def __bool__(self) -> bool:
        return bool(self._lines)

    def __len__(self) -> int:
        """How many owners have something waiting."""
        return len(self._lines)

    def count(self, owner: _K) -> int:
        """How much of an owner's waits."""
        return len(self._lines.get(owner, ()))

    def add(self, owner: _K, item: _T) -> None:
        """Add something behind all else of its owner."""
        line = self._lines.get(owner)
        if line is None:
            self._lines[owner] = deque((item,))
        else:
            line.append(item)

    def put_back(self, owner: _K, item: _T) -> None:
        """Something that was taken waits again, before all else of its owner."""
        self._lines.setdefault(owner, deque()).appendleft(item)

    def take(self) -> tuple[_K, _T]:
        """The first of the owner whose turn it is, who comes last then. Raises StopIteration if there is none."""
        owner = next(iter(self._lines))
        line = self._lines.pop(owner)
        item = line.popleft()
        if line:
            self._lines[owner] = line
        return owner, item

    def clear(self) -> None:
        """Forget all."""
        self._lines.clear()

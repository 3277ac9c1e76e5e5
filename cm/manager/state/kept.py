# SPDX-License-Identifier: Apache-2.0
"""What is made of immutable values, kept until others stand in their place."""

from __future__ import annotations

from collections.abc import Callable
from operator import is_
from typing import Generic, TypeVar

_T = TypeVar("_T")


class Kept(Generic[_T]):
    """The last result of a function, true as long as its inputs are the same objects. Any thread."""

    __slots__ = ("_last", "_make")

    def __init__(self, make: Callable[..., _T]) -> None:
        self._make = make
        self._last: tuple[tuple[object, ...], _T | None] = ((), None)

    def of(self, *things: object) -> _T:
        """`make` of them, not None."""
        before, made = self._last
        if made is None or not all(map(is_, things, before)):
            made = self._make(*things)
            self._last = things, made
        return made

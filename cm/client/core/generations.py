# SPDX-License-Identifier: Apache-2.0
"""Generations of the registers: what was written, and which frames began after it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cm.client.core.flow_effects import Deadline, Limit, seconds
from cm.errors import InvalidRequest, Timeout
from cm.wire.messages.status import RegValues

if TYPE_CHECKING:
    from cm.client.frame import Frame


class Written(dict[str, int]):
    """Values of registers after a write, by name; frames after the write have at least this `generation`."""

    generation: int

    def __init__(self, answer: RegValues) -> None:
        super().__init__([(v.name, v.value) for v in answer.values])
        self.generation = answer.generation


def number(write: Written | int) -> int:
    """The generation as a number. Raises InvalidRequest."""
    generation = write.generation if isinstance(write, Written) else write
    if isinstance(generation, bool) or not isinstance(generation, int) or generation < 0:
        raise InvalidRequest(f"after {write!r}: it takes what registers.write() returned, or a generation")
    return generation


class FirstAfter:
    """To read frames until one began after a write: ask for the time that is left, and offer each frame."""

    def __init__(self, stream: str, write: Written | int, timeout: Limit, default: float | None) -> None:
        self._generation = number(write)
        self._deadline = Deadline(seconds(timeout, default))
        self._stream = stream

    def left(self) -> float | None:
        """How long the next read may take. Raises Timeout when nothing is left."""
        left = self._deadline.left
        if left is not None and left <= 0:
            raise self.nothing()
        return left

    def has(self, frame: Frame) -> bool:
        """Whether this frame is the one; others are given back."""
        if frame.generation >= self._generation:
            return True
        frame.release()
        return False

    def nothing(self) -> Timeout:
        """None came."""
        limit = self._deadline.limit or 0
        return Timeout(f"stream {self._stream!r} gave no frame of generation {self._generation} within {limit:g} s")

# SPDX-License-Identifier: Apache-2.0
"""Incoming frames: copied once from DDS's own sample to where they are needed, if the library allows it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from cyclonedds.sub import DataReader

from cm.dds.dispatcher import logged
from cm.dds.library import Library, Taken
from cm.dds.types import Raw
from cm.errors import InvalidRequest
from cm.ros import cdr
from cm.ros.samples import hand_on
from cm.ros.transport import Body

_HEAD = 4096  # bytes that hold all fields before the frame's

Take = Callable[[dict[str, Any], Body], None]


class _Within:
    """Bytes in a sample that DDS holds."""

    def __init__(self, sample: Taken, offset: int, length: int) -> None:
        if offset + length > sample.size:
            raise InvalidRequest(f"{length} bytes are said to follow, {sample.size - offset} do")
        self._sample, self._offset, self.length = sample, offset, length

    def into(self, target: npt.NDArray[np.uint8]) -> None:
        self._sample.copy(self._offset, target.__array_interface__["data"][0], self.length)


def taking(library: Library | None, reader: DataReader, kind: str, take: Take) -> Callable[[], None]:
    """The function that takes all waiting frames of a reader."""
    sample = bytes(cdr.head(kind, {}, 7)) + b"1234567"
    if library is None or not library.pieces(reader._ref).proved(sample):
        return lambda: _by_python(reader, kind, take)
    return lambda: _by_library(library, reader, kind, take)


def _by_library(library: Library, reader: DataReader, kind: str, take: Take) -> None:
    for sample in library.taken(reader._ref):
        logged(partial(_handed, sample, kind, take))


def _handed(sample: Taken, kind: str, take: Take) -> None:
    values, length, offset = cdr.decode_head(kind, sample.start(_HEAD))
    take(values, _Within(sample, offset, length))


def _by_python(reader: DataReader, kind: str, take: Take) -> None:
    while samples := reader.take(N=4):
        for sample in samples:
            if isinstance(sample, Raw):
                logged(partial(hand_on, kind, sample.data, take))

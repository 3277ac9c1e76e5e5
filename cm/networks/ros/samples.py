# SPDX-License-Identifier: Apache-2.0
"""Messages of frames in one piece, for transports whose library accepts and delivers nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.errors import InvalidRequest
from cm.networks.ros import cdr
from cm.networks.ros.transport import Body


class Gathering:
    """A buffer that is used again for each message."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def gathered(self, head: bytearray, data: npt.NDArray[Any]) -> bytearray:
        """Head and frame in one piece: one copy, whatever lies between the frame's rows. Valid until the next call."""
        total = len(head) + data.nbytes
        if len(self._buffer) != total:
            self._buffer = bytearray(total)
        self._buffer[: len(head)] = head
        np.frombuffer(self._buffer, data.dtype, data.size, len(head)).reshape(data.shape)[...] = data
        return self._buffer


class Copied:
    """The bytes of a frame that the library has copied already."""

    def __init__(self, data: memoryview) -> None:
        self._data, self.length = data, len(data)

    def into(self, target: npt.NDArray[np.uint8]) -> None:
        """Copy them all."""
        target[:] = np.frombuffer(self._data, np.uint8)


def hand_on(kind: str, message: bytes | memoryview, take: Callable[[dict[str, Any], Body], None]) -> None:
    """Pass a message's fields, and the bytes of its last one, to `take`.

    Raises InvalidRequest for what is no such message.
    """
    values, length, offset = cdr.decode_head(kind, message)
    data = memoryview(message)[offset : offset + length]
    if len(data) != length:
        raise InvalidRequest(f"{length} bytes are said to follow, {len(data)} do")
    take(values, Copied(data))

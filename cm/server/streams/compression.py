# SPDX-License-Identifier: Apache-2.0
"""Compresses frames, in its own thread, for subscribers that ask for it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.server.sockets import Loop
from cm.server.streams.stream import Frame
from cm.wire.messages.status import FrameInfo

_WAITING = 2  # frames that are waiting or being compressed; further frames are dropped


class Unsupported(InvalidRequest):
    """This manager cannot do that, because a package is not installed on its machine."""

    code = "unsupported"


def compressions() -> tuple[str, ...]:
    """The compressions that are available here."""
    return ("lz4",) if find_spec("lz4") is not None else ()


def check_compression(wanted: str) -> None:
    """Raise Unsupported for a compression that is unknown, or not available here."""
    if wanted and wanted != "lz4":
        raise InvalidRequest(f"frames cannot be compressed with {wanted!r}; there is 'lz4'")
    if wanted and wanted not in compressions():
        raise Unsupported(
            f"frames cannot be compressed with {wanted!r}: the manager's machine has no package lz4 "
            "(apt install python3-lz4, or pip install lz4)"
        )


class Compressor:
    """Takes frames in the loop's thread, and delivers them compressed and in order, in the same thread."""

    def __init__(self, loop: Loop, deliver: Callable[[FrameInfo, bytes], None]) -> None:
        self._loop = loop
        self._deliver = deliver
        self._pool: ThreadPoolExecutor | None = None
        self._waiting = 0

    def offer(self, frame: Frame) -> bool:
        """Copy a frame and compress it later; return False if too many are waiting."""
        if self._waiting >= _WAITING:
            return False
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "cm-lz4")
        self._waiting += 1
        self._pool.submit(self._compress, replace(frame.info, compression="lz4"), bytes(frame.data))
        return True

    def _compress(self, info: FrameInfo, data: bytes) -> None:
        import lz4.frame

        try:
            packed = lz4.frame.compress(data, compression_level=0)
        finally:
            self._loop.call_threadsafe(self._ended)
        self._loop.call_threadsafe(lambda: self._deliver(info, packed))

    def _ended(self) -> None:
        self._waiting -= 1

    def close(self) -> None:
        """Wait for the thread to end."""
        if self._pool is not None:
            self._pool.shutdown()

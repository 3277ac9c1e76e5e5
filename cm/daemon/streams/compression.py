# SPDX-License-Identifier: Apache-2.0
"""Frames compressed for subscribers that ask for it, in a thread of their own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec

from cm.daemon.loop import Loop
from cm.daemon.streams.stream import Frame
from cm.errors import InvalidRequest
from cm.messages.status import FrameInfo

_WAITING = 2  # frames that are copied and wait, or are being compressed; more are left out


class Unsupported(InvalidRequest):
    """This manager cannot do that: a package is missing where it runs."""

    code = "unsupported"


def compressions() -> tuple[str, ...]:
    """What frames can be compressed with here."""
    return ("lz4",) if find_spec("lz4") is not None else ()


def check_compression(wanted: str) -> None:
    """Raise Unsupported for what frames cannot be compressed with."""
    if wanted and wanted != "lz4":
        raise InvalidRequest(f"frames cannot be compressed with {wanted!r}; there is 'lz4'")
    if wanted and wanted not in compressions():
        raise Unsupported(
            f"frames cannot be compressed with {wanted!r}: the manager's machine has no package lz4 "
            "(apt install python3-lz4, or pip install 'fpga-cm[lz4]')"
        )


class Compressor:
    """Takes frames in the loop's thread, and hands them on compressed, in order, in that thread again."""

    def __init__(self, loop: Loop, deliver: Callable[[FrameInfo, bytes], None]) -> None:
        self._loop = loop
        self._deliver = deliver
        self._pool: ThreadPoolExecutor | None = None
        self._waiting = 0

    def offer(self, frame: Frame) -> bool:
        """Compress a frame, which is copied first; False if too many wait."""
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
        """Wait for the thread."""
        if self._pool is not None:
            self._pool.shutdown()

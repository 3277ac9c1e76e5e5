# SPDX-License-Identifier: Apache-2.0
"""Streams of a board for a bridge: frames read in a thread of their own while anyone listens, and frames written."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cm.client.board import Board
from cm.errors import CmError, InvalidRequest, NotFound, Timeout
from cm.networks.bridge.records import FrameRecord, StreamFormat, frame_record

if TYPE_CHECKING:
    from cm.client.writer import Writer

_LOG = logging.getLogger("cm.bridge")
_WAIT = 0.25  # seconds between two checks whether a reader is to end
_DEPTH = 3  # slots of a reader, of which it has one, and the newest frame waits in another
_REREAD = 1.0  # seconds between two tries to read a stream that fails


class FrameReader:
    """Reads a stream while it is started. `take` gets each frame in the reader's thread, and must not keep its memory.

    Of the frames that come while `take` works, only the newest is kept.
    """

    def __init__(self, board: Board, stream: StreamFormat, take: Callable[[FrameRecord], None]) -> None:
        self._board, self._format, self._take = board, stream, take
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin; does nothing if it has begun already."""
        if self._thread is None:
            self._ending.clear()
            self._thread = threading.Thread(target=self._run, name=f"frames of {self._format.name}", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End, and wait for the call of `take` that is under way; twice is fine."""
        thread, self._thread = self._thread, None
        self._ending.set()
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._read()
            except Exception as error:  # noqa: BLE001 (the manager goes away, the mode has no such stream, `take` fails)
                if not isinstance(error, (CmError, OSError)):
                    _LOG.exception("frames of %s: it is tried again", self._format.name)
                self._ending.wait(_REREAD)

    def _read(self) -> None:
        offset = self._board.status.realtime_offset_ns
        with self._board.stream(self._format.name, depth=_DEPTH, newest=True) as stream:
            while not self._ending.is_set():
                try:
                    frame = stream.read(_WAIT)
                except Timeout:
                    continue
                self._take(frame_record(self._format, frame, frame.info, offset))
                frame.release()


class FrameWriter:
    """Frames towards the hardware: into slots if the manager runs on this machine, otherwise as messages."""

    def __init__(self, board: Board, stream: str, lease: str = "") -> None:
        self._board = board
        self._name = stream
        self._lease = lease
        self._writer: Writer | None = None
        self._remote = False

    def write(self, data: npt.NDArray[Any]) -> None:
        """One frame, in the stream's shape or as flat bytes. Raises the manager's refusal, or InvalidRequest."""
        flat = data.reshape(-1).view(np.uint8) if data.flags.c_contiguous else np.frombuffer(data.tobytes(), np.uint8)
        self.fill(flat.nbytes, lambda target: np.copyto(target, flat))

    def fill(self, length: int, fill: Callable[[npt.NDArray[np.uint8]], None]) -> None:
        """A frame of `length` bytes that `fill` writes into the slot itself. Raises as `write`."""
        writer = self._slots()
        if writer is None:
            flat = np.empty(length, np.uint8)
            fill(flat)
            self._board.write(self._name, flat, self._lease)
            return
        geometry = writer.geometry
        wanted = geometry.frame_length if geometry is not None else 0
        if wanted and wanted != length:
            raise InvalidRequest(f"stream {self._name!r} takes frames of {wanted} bytes; this one has {length}")
        with writer.slot(0 if wanted else length) as slot:
            if slot.flags.c_contiguous:
                fill(slot.reshape(-1).view(np.uint8))
            else:
                flat = np.empty(length, np.uint8)
                fill(flat)
                slot[...] = flat.view(slot.dtype).reshape(slot.shape)

    def close(self) -> None:
        """Give the slots back; twice is fine."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _slots(self) -> Writer | None:
        if self._writer is None and not self._remote:
            try:
                self._writer = self._board.writer(self._name, lease=self._lease)
            except (InvalidRequest, NotFound):  # a manager elsewhere, or another system than Linux
                self._remote = True
        return self._writer

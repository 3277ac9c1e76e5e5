# SPDX-License-Identifier: Apache-2.0
"""Topics that are published: messages, and frames from where the hardware put them."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from cyclonedds._clayer import ddspy_write
from cyclonedds.pub import DataWriter

from cm.bridge.records import FrameRecord
from cm.dds.library import Library, Pieces
from cm.ros import cdr
from cm.ros.samples import Gathering
from cm.ros.transport import Values

_LOG = logging.getLogger("cm.dds")


class DdsPublisher:
    """A writer; threads take turns. `library`: None if frames are to go through the Python API, which copies twice."""

    def __init__(
        self, writer: DataWriter, kind: str, library: Library | None, closed: Callable[[DdsPublisher, DataWriter], None]
    ) -> None:
        self.writer = writer
        self._kind = kind
        self._closed = closed
        self._lock = threading.Lock()
        self._library = library
        self._pieces: Pieces | None = None
        self._gathering = Gathering(align=4)
        self._copies = 0

    @property
    def copies(self) -> int:
        """How often the last frame was copied on its way into a sample; 0 before the first."""
        return self._copies

    def write(self, values: Values) -> None:
        """One message."""
        self.write_bytes(cdr.encode(self._kind, values))

    def write_bytes(self, sample: bytes | bytearray) -> None:
        """One that is serialised already."""
        with self._lock:
            if self.writer is not None:
                self._send(bytes(sample).ljust(len(sample) + -len(sample) % 4, b"\0"))

    def write_frame(self, head: Values, frame: FrameRecord) -> None:
        """A frame as the last field of a message."""
        data = frame.data
        start = cdr.head(self._kind, head, data.nbytes)
        with self._lock:
            if self.writer is None:
                return
            if not self._copies:
                self._pieces = _proved(self._library, self.writer, self._kind) if self._library is not None else None
                self._copies = 2 if self._pieces is None else 1
            if self._pieces is None:
                self._send(self._gathering.gathered(start, data))  # our own copy, before that of the Python API
                return
            try:
                self._pieces.write(start, _rows(data), data.nbytes)
            except OSError as error:
                _LOG.warning("%s: %s", self._kind, error)

    def _send(self, sample: bytes | bytearray) -> None:
        if ddspy_write(self.writer._ref, sample) < 0:
            _LOG.warning("%s: DDS did not take the sample", self._kind)

    def listeners(self) -> int:
        """How many readers match."""
        with self._lock:
            return 0 if self.writer is None else int(self.writer.get_publication_matched_status().current_count)

    def close(self) -> None:
        """End it; twice is fine."""
        with self._lock:
            writer, self.writer = self.writer, None
        if writer is not None:
            self._closed(self, writer)
            writer.__del__()


def _proved(library: Library, writer: DataWriter, kind: str) -> Pieces | None:
    """The maker of samples from pieces, if it has been shown to make correct ones."""
    sample = bytes(cdr.head(kind, {}, 7)) + b"1234567"
    try:
        pieces = library.pieces(writer._ref)
        if pieces.proved(sample):
            return pieces
    except OSError as error:
        _LOG.warning("%s", error)
    _LOG.warning("this cyclonedds makes other samples from pieces than it should: frames are copied twice")
    return None


def _rows(data: npt.NDArray[Any]) -> list[tuple[int, int]]:
    """Addresses and lengths of contiguous memory, in order: single rows if something lies between them."""
    if data.flags.c_contiguous:
        return [(data.__array_interface__["data"][0], data.nbytes)]
    if data.ndim > 1 and data[0].flags.c_contiguous:
        start, step, row = data.__array_interface__["data"][0], data.strides[0], data[0].nbytes
        return [(start + number * step, row) for number in range(data.shape[0])]
    whole = np.ascontiguousarray(data)
    return [(whole.__array_interface__["data"][0], whole.nbytes)]

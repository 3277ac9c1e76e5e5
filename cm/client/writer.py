# SPDX-License-Identifier: Apache-2.0
"""Writing frames without copies: borrow a slot, fill it, and give it to the hardware."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from cm.client.allocation import DeviceArray
from cm.client.core.flow_effects import DEFAULT, Limit, seconds, time_limit
from cm.client.data_connection import DataConnection
from cm.client.errors import BoardClosed, ConnectionLost, TransferFailed
from cm.client.mapping import SlotMappings
from cm.client.pixel_formats import AS_IT_IS, from_rgb, is_rgb
from cm.errors import CmError, InvalidRequest, Timeout
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor, Geometry, Open, Purpose

Self = TypeVar("Self", bound="Writer")

# What memory and socket raise if another thread closes the writer meanwhile; then that is what is said.
_BROKEN = (CmError, OSError, LookupError, ValueError, AttributeError)


class Writer:
    """A stream towards the hardware. One thread at a time.

    A failed frame raises TransferFailed at the next call.
    """

    def __init__(self, folder: Path, wanted: Open, timeout: float | None, owner: Any = None) -> None:
        self._owner = owner  # the board, which this keeps alive
        self._closed: CmError | None = None
        self._timeout = timeout = time_limit(timeout)
        self._connection = DataConnection(folder, wanted)
        self.name: str = wanted.name
        self._stands = wanted.purpose is Purpose.ECHO  # no hardware is behind an echo: nothing takes its slots back
        self._next = 0
        self.moved = 0  # bytes of the frame that was done last
        self._under_way: dict[
            int, tuple[int, DeviceArray | None, object]
        ] = {}  # by sequence: bytes, and whose, if they are ours, and what keeps its memory
        self._failed: list[tuple[Descriptor, int]] = []  # with the bytes that were asked for

    def open(self) -> None:
        """Wait for the first slot, as `Board.writer` does. Raises the manager's refusal, Timeout."""
        try:
            self._wait(lambda: bool(self._connection.granted), self._timeout)
        except BaseException:
            self._connection.close()
            raise

    @property
    def geometry(self) -> Geometry | None:
        """Shape, dtype, slots; None while the stream is stopped."""
        return self._connection.geometry

    @property
    def under_way(self) -> int:
        """Frames that the hardware has not taken yet."""
        return len(self._under_way)

    @property
    def free(self) -> int:
        """Slots that are available at once."""
        return len(self._connection.granted)

    def poll(self) -> bool:
        """Process what has happened, if anything; never waits."""
        self._check()
        try:
            self._connection.take()
        except BlockingIOError:
            return False
        self._collect()
        return True

    def catch_up(self) -> None:
        """Process what has come: a change of mode takes all slots back, and what is sent in them then goes nowhere."""
        self._check()
        try:
            while self._connection.waiting():
                self.poll()
        except _BROKEN:
            self._check()
            raise

    def slot(self, length: int = 0, timeout: Limit = DEFAULT) -> AbstractContextManager[npt.NDArray[Any]]:
        """A free slot as an array to fill; it is sent when the block ends, unless the block raises.

        `length` bytes of it, as flat uint8; a whole frame in the stream's shape if 0. Waits for a slot.
        Raises Timeout, TransferFailed of an earlier frame.
        """
        if not self._stands:
            self.catch_up()
        return self.lend(length, timeout)

    @contextmanager
    def lend(self, length: int = 0, timeout: Limit = DEFAULT) -> Iterator[npt.NDArray[Any]]:
        """As `slot`, for those who have just caught up."""
        grant, memory = self._borrow(length, timeout)
        try:
            yield self._begun(grant, memory, length)
        except BaseException:
            memory.end(grant.slot)
            self._put_back(grant, memory)
            raise
        memory.end(grant.slot)
        try:
            self._submit(grant, length or memory.whole)
        except _BROKEN:
            self._check()
            raise

    def _begun(self, grant: Descriptor, memory: SlotMappings, length: int) -> npt.NDArray[Any]:
        try:
            array = memory.slot_array(grant.slot, length)
            memory.begin(grant.slot)
        except _BROKEN:
            self._check()
            raise
        return array

    def write(self, data: npt.ArrayLike, timeout: Limit = DEFAULT) -> None:
        """Copy a frame, as an array or its bytes, into a slot and send it; returns at once. Raises as `slot` does.

        An array (rows, columns, 3) for a stream with a `format` is RGB; all else is sent as it is.
        """
        if not self._stands:
            self.catch_up()
        self.send(data, timeout)

    def send(self, data: npt.ArrayLike, timeout: Limit = DEFAULT) -> None:
        """As `write`, for those who have just caught up."""
        plain = isinstance(data, (bytes, bytearray, memoryview))
        array = np.frombuffer(data, np.uint8) if plain else np.asarray(data)  # type: ignore[arg-type]
        geometry = self.geometry
        if geometry is not None and geometry.format not in AS_IT_IS and is_rgb(data):
            array = from_rgb(array, geometry.format)
        if geometry is not None and geometry.frame_length and array.nbytes != geometry.frame_length:
            raise InvalidRequest(
                f"stream {self.name!r} takes frames of {geometry.frame_length} bytes, {geometry.shape} "
                f"{geometry.dtype}; this one has {array.nbytes}, {array.shape} {array.dtype}"
            )
        length = 0 if geometry is not None and geometry.frame_length else array.nbytes
        with self.lend(length, timeout) as slot:
            slot[...] = self._fitted(array, slot, as_bytes=bool(length) or array.dtype == np.uint8)

    def _fitted(self, array: npt.NDArray[Any], slot: npt.NDArray[Any], as_bytes: bool) -> npt.NDArray[Any]:
        if as_bytes:
            array = np.frombuffer(array.tobytes(), slot.dtype)
        if array.size != slot.size:
            raise InvalidRequest(
                f"stream {self.name!r} takes frames of {slot.shape} {slot.dtype}; "
                f"this one is {array.shape} {array.dtype}"
            )
        return array.reshape(slot.shape)

    def flush(self, timeout: Limit = DEFAULT) -> None:
        """Wait until the hardware has taken all frames. Raises Timeout, TransferFailed."""
        self._wait(lambda: not self._under_way, seconds(timeout, self._timeout))
        self._raise_failures()

    def round_trip(self, length: int = 0) -> Descriptor:
        """Send a slot as it is and wait until it is done: the cost of a frame without its bytes."""
        grant, memory = self._borrow(length, DEFAULT)
        self._submit(grant, length or memory.whole)
        connection, number = self._connection, self._next - 1
        connection.set_timeout(self._timeout)
        while number in self._under_way:
            connection.receive()
            self._collect()
        self._raise_failures()
        return grant

    def _check(self) -> None:
        if self._closed is not None:
            raise self._closed

    def _borrow(self, length: int, timeout: Limit) -> tuple[Descriptor, SlotMappings]:
        """A slot for `length` bytes, 0: all of it. What is wrong with the length is said before a slot is taken."""
        self._check()
        self._raise_failures()
        connection = self._connection
        if not connection.granted:
            self._wait(lambda: bool(connection.granted), seconds(timeout, self._timeout))
            self._raise_failures()
        memory = connection.memory
        if memory is None:  # closed by another thread
            raise self._closed or ConnectionLost(f"the stream {self.name!r} was stopped")
        if length:
            self._check_length(length, memory)
        return connection.granted.pop(), memory

    def _check_length(self, length: int, memory: SlotMappings) -> None:
        form = memory.geometry
        if form.stride and length != memory.whole:
            raise InvalidRequest(
                f"stream {self.name!r}: its lines lie apart, so only whole frames of {memory.whole} bytes"
            )
        if not 0 < length <= memory.whole:
            more = "" if form.frame_length else "; the schema's slot_bytes says how many"
            raise InvalidRequest(f"stream {self.name!r}: a slot takes 1 to {memory.whole} bytes, not {length}{more}")

    def _put_back(self, grant: Descriptor, memory: SlotMappings) -> None:
        if memory is self._connection.memory:
            self._connection.granted.append(grant)

    def _submit(self, grant: Descriptor, length: int) -> None:
        self._under_way[self._next] = length, None, None
        self._connection.submit(grant, 0, length, self._next)
        self._next += 1

    def _wait(self, ready: Callable[[], bool], timeout: float | None) -> None:
        until = None if timeout is None else time.monotonic() + timeout
        self._check()
        self._collect()
        try:
            left = timeout
            while not ready():
                self._connection.set_timeout(left)
                self._connection.receive()
                self._collect()
                left = None if until is None else max(0.0, until - time.monotonic())
        except BlockingIOError:
            raise Timeout(self.nothing(timeout)) from None
        except ConnectionLost as error:
            raise self._closed or error from None  # closed by another thread

    def nothing(self, limit: float | None) -> str:
        """Why no slot may have come back, in a sentence."""
        return (
            f"stream {self.name!r}: the hardware took nothing within {limit or 0:g} s; "
            "is anything reading the output, and is the region coupled?"
        )

    def _collect(self) -> None:
        """Note which frames are done; their slots are free again, unless the hardware repeats the frame."""
        connection = self._connection
        while connection.done:
            done = connection.done.popleft()
            if done.kind != packets.DONE:
                continue
            asked, array, _ = self._under_way.pop(done.sequence, (done.length, None, None))
            if array is not None and self.geometry is not None and not self.geometry.writable:
                array.hand_over(to_device=False)
            self.moved = done.length
            if done.offset:
                self._failed.append((done, asked))
            memory = connection.memory
            if memory is not None and done.flags == memory.epoch and not (memory.geometry.cyclic and not done.offset):
                connection.granted.append(done)

    def _raise_failures(self) -> None:
        if self._failed:
            failed, self._failed = self._failed[0], []
            raise TransferFailed(f"stream {self.name!r}: {self._sentence(*failed)}: {os.strerror(failed[0].offset)}")

    def _sentence(self, failed: Descriptor, _: int) -> str:
        return f"frame {failed.sequence} was not taken"

    def fileno(self) -> int:
        """Descriptor that polls readable when a frame is done."""
        return self._connection.socket.fileno()

    def close(self) -> None:
        """Disconnect; frames under way are still sent. Twice is fine."""
        self._closed = self._closed or InvalidRequest(f"the writer of {self.name!r} was closed: ask for another")
        self._connection.close()

    def end(self, because: BoardClosed) -> None:
        """The board is closed; any later use raises BoardClosed."""
        self._closed = because
        self.close()

    def __del__(self) -> None:
        if self._closed is None and hasattr(self, "_connection"):  # dropped without being closed
            self.close()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<writer of {self.name or 'an echo'}>"


class Transfers(Writer):
    """Transfers of one's own memory: from it to the hardware, or into it, as the stream goes. No byte is copied."""

    def begin(self, array: DeviceArray, start: int = 0, nbytes: int = 0, timeout: Limit = DEFAULT) -> None:
        """Begin to transfer `nbytes` (0: the rest) of an array of `Board.allocate`, from byte `start` on.

        Up to four may be under way; `flush` waits for them, and `moved` is what the last one moved. A packet from the
        hardware that is longer fails. Raises InvalidRequest for what is not the array's, TypeError, Timeout,
        TransferFailed of an earlier one.
        """
        if not isinstance(array, DeviceArray):
            raise TypeError(f"transfers are of arrays of allocate(), not of {type(array).__name__}")
        length = nbytes or array.nbytes - start
        if start < 0 or length <= 0 or start + length > array.nbytes or not array.flags.c_contiguous:
            raise InvalidRequest(
                f"bytes {start} to {start + length} are not in one piece in an array of {array.nbytes} bytes"
            )
        self.catch_up()
        grant, memory = self._borrow(0, timeout)
        if length > memory.geometry.slot_length:
            self._put_back(grant, memory)
            raise InvalidRequest(
                f"stream {self.name!r}: {length} bytes; the engine moves {memory.geometry.slot_length} at once, and "
                "the logic would take two transfers for two packets"
            )
        address = array.device_address + start
        array.hand_over(to_device=True)
        self._under_way[self._next] = length, array, array.hold
        self._connection.submit(grant._replace(timestamp_ns=address), 0, length, self._next)
        self._next += 1

    def _sentence(self, failed: Descriptor, asked: int) -> str:
        longer = " (a packet may have been longer)" if failed.offset == errno.EIO else ""
        return f"a transfer failed after {failed.length} of {asked} bytes{longer}"

    def slot(self, length: int = 0, timeout: Limit = DEFAULT) -> Any:  # noqa: ARG002 - a writer's signature
        """Not possible: there are no slots."""
        raise InvalidRequest(f"stream {self.name!r} transfers the memory of arrays: begin(array)")

    lend = slot

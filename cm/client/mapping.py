# SPDX-License-Identifier: Apache-2.0
"""The memory of a stream's slots, mapped here, and frames that lie in it."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.errors import FrameReleased
from cm.client.frame import NO_INFO, Frame, checked
from cm.client.pixel_formats import AS_IT_IS
from cm.errors import InvalidRequest
from cm.wire.messages.status import FrameInfo
from cm.wire.plane_packets import Descriptor, Geometry

# DMA_BUF_IOCTL_SYNC and its flags, linux/dma-buf.h
_SYNC = 0x40086200
_READ, _WRITE, _END = 1, 2, 4


class SlotMappings:
    """The slots of one geometry. Mappings live as long as frames in them do."""

    def __init__(self, geometry: Geometry, epoch: int) -> None:
        self._fds: list[int] = []  # kept where the memory needs synchronising
        self.geometry = geometry
        self.epoch = epoch
        self.names = (geometry.stream, geometry.config_name, geometry.mode)
        self.dtype = np.dtype(geometry.dtype)
        self.coded = geometry.format not in AS_IT_IS  # its pixels are not those of an array in RGB
        self.strides = self._strides()
        self.whole = geometry.frame_length or geometry.slot_length  # bytes of a frame that is written
        self._maps: list[mmap.mmap] = []
        self._begun: set[int] = set()  # slots that the processor uses now, where that matters
        self._closed = False
        self._syncs = not geometry.coherent

    def _strides(self) -> tuple[int, ...] | None:
        shape = self.geometry.shape
        if not self.geometry.stride or shape is None:
            return None
        return (self.geometry.stride, *_packed(shape, self.dtype.itemsize)[1:])

    def __len__(self) -> int:
        return len(self._maps)

    def take(self, slot: int) -> mmap.mmap:
        """The mapping of a slot, which lives from here on as long as something else refers to it."""
        return self._maps.pop(slot)

    def add(self, first: int, fds: Sequence[int]) -> None:
        """Map slots, all pages at once, and take over their descriptors."""
        access = mmap.PROT_READ | (mmap.PROT_WRITE if self.geometry.writable else 0)
        try:
            if first != len(self._maps):
                raise InvalidRequest(f"slots from {first} on came, {len(self._maps)} was expected")
            for fd in fds:
                length = self.geometry.slot_length
                self._maps.append(mmap.mmap(fd, length, mmap.MAP_SHARED | mmap.MAP_POPULATE, access))
        finally:
            if self.geometry.coherent:
                for fd in fds:
                    os.close(fd)
            else:
                self._fds.extend(fds)

    def begin(self, slot: int) -> None:
        """Announce that the processor is about to read or write; twice is fine."""
        if self._syncs and slot not in self._begun:
            self._sync(slot, 0)
            self._begun.add(slot)

    def end(self, slot: int) -> None:
        """The processor is done; twice is fine."""
        if slot in self._begun:
            self._sync(slot, _END)
            self._begun.discard(slot)
            if self._closed and not self._begun:
                self._close_fds()

    def hand_over(self, slot: int, end: bool) -> None:
        """The same, whatever was announced before: for memory that both sides use in turns that we do not see."""
        if self._syncs and self._fds:
            self._sync(slot, _END if end else 0)
            (self._begun.discard if end else self._begun.add)(slot)

    def _sync(self, slot: int, end: int) -> None:
        argument = struct.pack("=Q", end | _READ | (_WRITE if self.geometry.writable else 0))
        while True:
            try:
                fcntl.ioctl(self._fds[slot], _SYNC, argument)
                return
            except OSError as error:
                if error.errno == errno.ENOTTY:  # ordinary memory
                    return
                if error.errno not in (errno.EINTR, errno.EAGAIN):  # the caller has to try again
                    raise

    def array(self, frame: Descriptor, kind: type[Any] = np.ndarray) -> Any:
        """A frame's bytes as an array: whole ones in the stream's shape, others flat."""
        geometry = self.geometry
        if geometry.shape is not None and frame.length == geometry.frame_length:
            return kind(geometry.shape, self.dtype, self._maps[frame.slot], frame.offset, self.strides)
        return kind((frame.length,), np.uint8, self._maps[frame.slot], frame.offset)

    def slot_array(self, slot: int, length: int = 0) -> npt.NDArray[Any]:
        """A slot to write a frame to; `length` bytes of it, a whole frame if 0."""
        array: npt.NDArray[Any] = self.array(Descriptor(slot, length=length or self.whole))
        return array

    def close(self) -> None:
        """No more frames come; those in use stay until they are given back."""
        self._closed = True
        self._maps.clear()
        if not self._begun:
            self._close_fds()

    def disown(self) -> None:
        """This process was forked: slots that its parent uses stay as they are."""
        self._closed, self._syncs = True, False
        self._begun.clear()
        self._close_fds()

    def _close_fds(self) -> None:
        fds, self._fds = self._fds, []
        for fd in fds:
            os.close(fd)

    def __del__(self) -> None:
        self._close_fds()


def _packed(shape: tuple[int, ...], size: int) -> tuple[int, ...]:
    strides = [size]
    for extent in reversed(shape[1:]):
        strides.insert(0, strides[0] * extent)
    return tuple(strides)


@checked
class LocalFrame(Frame):
    """A frame in DMA memory, leased until it and every array made from it are gone, or `release` is called."""

    _lease: Lease | None = None

    @property
    def info(self) -> FrameInfo:
        lease = self._held()
        if lease.last is not None:
            return lease.last[0]
        frame, memory = lease.frame, lease.memory
        return FrameInfo(
            memory.names[0],
            frame.sequence,
            frame.timestamp_ns,
            frame.length,
            tuple(self.shape),
            str(self.dtype),
            lease.names[1],
            lease.names[2],
            generation=lease.counts[0],
            format=memory.geometry.format if self.ndim == 3 else "",
            failed=lease.counts[1],
            lost=lease.counts[2],
        )

    @property
    def sequence(self) -> int:
        return self._held().frame.sequence

    @property
    def timestamp_ns(self) -> int:
        return self._held().frame.timestamp_ns

    @property
    def generation(self) -> int:
        return self._held().counts[0]

    def release(self) -> None:
        """Give the slot back now; any use of the frame raises FrameReleased from here on. Twice is fine.

        What C takes of it without asking is empty then (`np.asarray(frame)`, `memoryview(frame)`). Arrays and buffers
        made from it before show whatever comes into the slot next.
        """
        lease = self._lease
        if lease is not None and not lease.ended:
            lease.last = self.info, self.base  # the base is what those arrays lie in
            np.ndarray.__setstate__(self, (1, (0,) * self.ndim, self.dtype, False, b""))  # type: ignore[arg-type]
            lease.end()

    @property
    def released(self) -> bool:
        """Whether the slot was given back."""
        return self._lease is not None and self._lease.ended

    def _held(self) -> Lease:
        if self._lease is None:
            raise AttributeError(NO_INFO)
        return self._lease

    def _check(self) -> None:
        if self._lease is not None and self._lease.ended:
            raise FrameReleased(
                f"frame {self._lease.frame.sequence} of {self._lease.names[0]!r} was given back; "
                "keep a copy() of what you need longer"
            )

    def copy(self, order: Any = "C") -> npt.NDArray[Any]:
        """The content as a plain, writable array."""
        self._check()
        return super().copy(order)

    def _repr_png_(self) -> bytes | None:
        return None if self.released else super()._repr_png_()

    def __getitem__(self, key: Any) -> Any:
        self._check()
        return super().__getitem__(key)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*(_plain(i) for i in inputs), **options)

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        self._check()
        return super().__array_function__(function, types, args, kwargs)

    def tobytes(self, order: Any = "C") -> bytes:
        """The content as bytes."""
        self._check()
        return super().tobytes(order)

    def __dlpack__(self, *args: Any, **kwargs: Any) -> Any:
        self._check()
        return np.asarray(self).__dlpack__(*args, **kwargs)

    def _is_view(self) -> bool:
        return self._lease is None

    def __repr__(self) -> str:
        lease = self._lease
        if lease is None or not lease.ended:
            return str(np.ndarray.__repr__(self))
        return f"<frame {lease.frame.sequence} of {lease.names[0]!r}, given back>"

    def __str__(self) -> str:
        return repr(self) if self.released else str(np.ndarray.__str__(self))

    # Only the end of the last reference to an array shows that it is no longer used: numpy has no other hook, and
    # views of the frame keep it alive as their base.
    def __del__(self) -> None:
        if self._lease is not None:
            self._lease.end()


def _plain(value: Any) -> Any:
    if isinstance(value, LocalFrame):
        value._check()
        return np.asarray(value)
    return value


class Lease:
    """The right to a slot's content."""

    __slots__ = ("_give_back", "counts", "ended", "frame", "last", "memory", "names")

    def __init__(
        self,
        memory: SlotMappings,
        frame: Descriptor,
        names: tuple[str, str, str],
        give_back: Callable[[SlotMappings, Descriptor], None],
        counts: tuple[int, int, int],
    ) -> None:
        self.counts = counts  # as `FrameInfo` has them: generation, failed, lost
        self.memory = memory
        self.frame = frame
        self.names = names
        self.ended = False
        self.last: tuple[FrameInfo, Any] | None = None  # of a frame that was given back: what it was, and lay in
        self._give_back = give_back

    def end(self) -> None:
        """Give it back, once."""
        if not self.ended:
            self.ended = True
            self._give_back(self.memory, self.frame)


def lend(
    memory: SlotMappings,
    frame: Descriptor,
    names: tuple[str, str, str],
    give_back: Callable[[SlotMappings, Descriptor], None],
    counts: tuple[int, int, int] = (0, 0, 0),
) -> LocalFrame:
    """A leased frame as an array."""
    array: LocalFrame = memory.array(frame, LocalFrame)
    array._lease = Lease(memory, frame, names, give_back, counts)
    memory.begin(frame.slot)
    return array

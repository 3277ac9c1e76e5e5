# SPDX-License-Identifier: Apache-2.0
"""Channels of AXI DMA and VDMA engines."""

from __future__ import annotations

import enum
import errno
from pathlib import Path
from typing import ClassVar

from cm.device import advice
from cm.device.base import AnyRoot, Device, Shim, open_handle
from cm.device.buffer import DmaBuffer
from cm.device.native import axidma as native
from cm.device.native.call import Handle
from cm.device.paths import Root
from cm.frozen import dataclass

FOLDER = "dev/cm_dma"


class Direction(enum.Enum):
    """Direction of a channel, seen from memory as the AXI DMA's data sheet (PG021) does."""

    MM2S = native.MM2S
    S2MM = native.S2MM


class DmaType(enum.Enum):
    """Kind of engine."""

    AXIDMA = native.TYPE_AXIDMA
    VDMA = native.TYPE_VDMA


class DmaCaps(enum.Flag):
    """What a channel can do; RESIDUE: short packets report their length; SIMPLE: its engine has no scatter/gather."""

    NONE = 0
    CYCLIC = native.CAP_CYCLIC
    VIDEO = native.CAP_VIDEO
    RESIDUE = native.CAP_RESIDUE
    SIMPLE = native.CAP_SIMPLE


_KNOWN_CAPS = native.CAP_CYCLIC | native.CAP_VIDEO | native.CAP_RESIDUE | native.CAP_SIMPLE


@dataclass(frozen=True, slots=True)
class DmaInfo:
    """A channel; lengths and alignment in bytes, ``frame_length`` 0 if the hardware does not fix one."""

    name: str
    direction: Direction
    type: DmaType
    caps: DmaCaps
    queue_depth: int
    max_length: int
    alignment: int
    frame_length: int

    @property
    def tells_length(self) -> bool:
        """Whether a completion says how many bytes arrived, and not only how many were asked for."""
        return bool(self.caps & DmaCaps.RESIDUE)


@dataclass(frozen=True, slots=True)
class Completion:
    """A finished transfer.

    ``length`` is the bytes that moved, with S2MM perhaps fewer than asked for (but see
    ``DmaInfo.tells_length``); ``status`` 0 or a
    negative errno (-EIO, -ECANCELED); ``timestamp_ns`` of CLOCK_MONOTONIC; ``overrun``: cyclic
    periods were lost before this one.
    """

    cookie: int
    length: int
    timestamp_ns: int
    sequence: int
    status: int
    overrun: bool

    @property
    def ok(self) -> bool:
        """Whether the transfer succeeded."""
        return self.status == 0


def list_dma(root: AnyRoot = None) -> list[str]:
    """Return the names of all DMA channels, sorted."""
    return advice.names(Root.of(root).join(FOLDER))


def _completion(raw: native.Completion) -> Completion:
    overrun = bool(raw.flags & native.OVERRUN)
    return Completion(raw.cookie, raw.length, raw.timestamp_ns, raw.sequence, raw.status, overrun)


class AxiDma(Device):
    """One DMA channel, claimed as long as it is open.

    Transfers complete in the order in which they were submitted.  Closing stops them; buffers that
    are still open keep their memory.
    """

    _shim: ClassVar[Shim] = native

    def __init__(self, handle: Handle, path: Path) -> None:
        """Take over an open handle; use `open`."""
        super().__init__(handle, path)
        self._info: DmaInfo | None = None

    @classmethod
    def open(cls, name: str, root: AnyRoot = None) -> AxiDma:
        """Claim the channel /dev/cm_dma/``name``.

        Raises DeviceBusy while another file holds it, DeviceNotFound, DevicePermission, DeviceGone.
        """
        base = Root.of(root)
        path = base.join(FOLDER, name)
        return cls(open_handle(native.open_channel, base, path, name, list_dma), path)

    @property
    def info(self) -> DmaInfo:
        """What the channel is; asked once."""
        if self._info is None:
            try:
                raw = native.info(self._handle)
            except OSError as error:
                raise self._error(error, "describe") from error
            kind, caps = DmaType(raw.type), DmaCaps(raw.caps & _KNOWN_CAPS)
            depth = raw.queue_depth, raw.max_length, raw.alignment, raw.frame_length
            self._info = DmaInfo(raw.name, Direction(raw.direction), kind, caps, *depth)
        return self._info

    @property
    def shim_handle(self) -> Handle:
        """The handle that `cm.device.data_plane` passes to C; valid as long as this object."""
        return self._handle

    def allocate(self, length: int) -> DmaBuffer:
        """Return a new buffer of at least ``length`` bytes that the channel can reach."""
        try:
            raw = native.alloc(self._handle, length)
        except (OSError, OverflowError) as error:
            hint = "the CMA area may be too small (cma= on the kernel's command line)"
            short = isinstance(error, OSError) and error.errno == errno.ENOMEM
            raise self._error(error, f"allocate {length} bytes on", hint if short else "") from error
        return DmaBuffer(raw, self._free, self.path)

    def import_buffer(self, fd: int, length: int | None = None) -> DmaBuffer:
        """Attach a foreign dma-buf; ``fd`` stays the caller's.

        With ``length`` (bytes) raises DeviceInvalid if the buffer is shorter.
        """
        try:
            raw = native.import_fd(self._handle, fd)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"import descriptor {fd} into") from error
        buffer = DmaBuffer(raw, self._free, self.path)
        try:
            buffer.check_range(0, length or 0)
        except BaseException:
            buffer.close()
            raise
        return buffer

    def submit(
        self,
        buffer: DmaBuffer,
        offset: int = 0,
        length: int | None = None,
        cookie: int = 0,
        cyclic: bool = False,
        period: int = 0,
    ) -> None:
        """Queue a transfer of ``length`` bytes (default: the rest of the buffer); does not wait.

        ``cookie`` comes back in the completion.  A cyclic one repeats until `cancel`, with a
        completion for every ``period`` bytes.  Raises DeviceBusy when ``info.queue_depth`` transfers
        are under way, DeviceInvalid for a range or alignment that does not fit.
        """
        length = buffer.length - offset if length is None else length
        flags = native.SUBMIT_CYCLIC if cyclic else 0
        try:
            native.submit(self._handle, buffer.handle, offset, length, cookie, flags, period)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"submit {length} bytes at {offset} to") from error

    def submit_video(
        self, buffer: DmaBuffer, lines: int, line_bytes: int, stride: int, offset: int = 0, cookie: int = 0
    ) -> None:
        """Queue one video frame: ``lines`` of ``line_bytes``, each ``stride`` bytes after the last."""
        try:
            native.submit_video(self._handle, buffer.handle, offset, lines, line_bytes, stride, cookie, 0)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"submit a frame of {lines} lines of {line_bytes} bytes to") from error

    def completions(self) -> list[Completion]:
        """Return the completions that are there, in order, at most 64 at a time; never blocks."""
        try:
            return [_completion(raw) for raw in native.take(self._handle)]
        except OSError as error:
            raise self._error(error, "take completions of") from error

    def wait(self, timeout: float | None = None) -> Completion:
        """Wait up to ``timeout`` seconds for the next completion; DeviceTimeout.

        A transfer that failed is a completion with a ``status``, not an exception.
        """
        try:
            return _completion(native.wait_completion(self._handle, timeout))
        except OSError as error:
            raise self._error(error, "wait for a completion of") from error

    def cancel(self) -> None:
        """End all transfers; each gets a completion with -ECANCELED.  The hardware has stopped on return."""
        try:
            native.cancel(self._handle)
        except OSError as error:
            raise self._error(error, "cancel the transfers of") from error

    def _free(self, handle: int) -> None:
        native.free(self._handle, handle)

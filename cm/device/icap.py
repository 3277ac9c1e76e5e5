# SPDX-License-Identifier: Apache-2.0
"""Internal configuration access ports, fed by DMA."""

from __future__ import annotations

import enum
import os
from pathlib import Path
from typing import ClassVar

from cm.device import advice
from cm.device.base import AnyRoot, Device, Shim, open_handle
from cm.device.buffer import DmaBuffer
from cm.device.native import icap as native
from cm.device.native.call import Handle
from cm.device.paths import Root, Standing
from cm.frozen import dataclass


class IcapState(enum.Enum):
    """What a port does; ERROR: its last load failed."""

    IDLE = native.STATE_IDLE
    LOADING = native.STATE_LOADING
    ERROR = native.STATE_ERROR


class IcapErrors(enum.Flag):
    """Why a load failed (UG470, table 5-28, and the DMA engine)."""

    NONE = 0
    CRC = native.ERR_CRC
    ID = native.ERR_ID
    DMA = native.ERR_DMA
    TIMEOUT = native.ERR_TIMEOUT
    NOSYNC = native.ERR_NOSYNC
    PORT = native.ERR_PORT


_SENTENCES = {
    IcapErrors.CRC: "the CRC does not match (the file was damaged after it was built, or on its way here)",
    IcapErrors.ID: "the bitstream is for another device (IDCODE)",
    IcapErrors.DMA: "the DMA engine reported an error",
    IcapErrors.TIMEOUT: "the port did not finish",
    IcapErrors.NOSYNC: "no sync word was seen",
    IcapErrors.PORT: "the port reports an error without its cause",
}


@dataclass(frozen=True, slots=True)
class IcapInfo:
    """A port; ``clock_hz`` and ``idcode`` are 0 where the driver does not know them.

    ``readable``: words can be read from the port, not only written to it (`Icap.read`).
    ``denied``: the platform's firmware refused the port when the driver asked for it, and loads end with EACCES.
    """

    word_bits: int
    clock_hz: int
    max_length: int
    idcode: int
    has_status: bool
    denied: bool = False
    readable: bool = False


@dataclass(frozen=True, slots=True)
class IcapStatus:
    """What a port does now; bytes are of the running or the last load, as far as the driver can tell."""

    state: IcapState
    errors: IcapErrors
    bytes_done: int
    bytes_total: int
    loads: int

    @property
    def loading(self) -> bool:
        """Whether a load runs, also one that another process began."""
        return self.state is IcapState.LOADING


@dataclass(frozen=True, slots=True)
class IcapCompletion:
    """The end of a load; times of CLOCK_MONOTONIC, ``status`` 0 or a negative errno."""

    cookie: int
    length: int
    started_ns: int
    finished_ns: int
    status: int
    errors: IcapErrors

    @property
    def ok(self) -> bool:
        """Whether the load succeeded."""
        return self.status == 0

    @property
    def reason(self) -> str:
        """A sentence for why it failed, "" if it did not."""
        named = [text for bit, text in _SENTENCES.items() if bit in self.errors]
        return "" if self.ok else "; ".join(named) or os.strerror(-self.status)


def _errors(bits: int) -> IcapErrors:
    return IcapErrors(bits & 0x3F)


def _completion(raw: native.Completion) -> IcapCompletion:
    return IcapCompletion(raw.cookie, raw.length, raw.started_ns, raw.finished_ns, raw.status, _errors(raw.errors))


def _range(part: slice) -> tuple[int, int]:
    return part.start, part.stop - part.start


def list_icap(root: AnyRoot = None) -> list[str]:
    """Return the names of all configuration ports, sorted."""
    return [name for name in advice.names(Root.of(root).join("dev")) if name.startswith("cm_icap")]


class Icap(Device):
    """A configuration port.  Any number of files may be open; one load runs at a time."""

    _shim: ClassVar[Shim] = native

    def __init__(self, handle: Handle, path: Path, node: Standing) -> None:
        """Take over an open handle; use `open`. `node` is what was opened."""
        super().__init__(handle, path)
        self._node = node

    @classmethod
    def open(cls, name: str = "cm_icap0", root: AnyRoot = None) -> Icap:
        """Open the port /dev/``name``.  Raises DeviceNotFound, DevicePermission, DeviceGone."""
        base = Root.of(root)
        path: Path = base.join("dev", name)
        node = Standing(path)  # before it is opened: one that comes later is another
        return cls(open_handle(native.open_port, base, path, name, list_icap), path, node)

    @property
    def present(self) -> bool:
        """Whether the port that was opened is still there: overlays take some, and names are used again."""
        return self._node.stands

    @property
    def info(self) -> IcapInfo:
        """What the port is."""
        try:
            raw = native.info(self._handle)
        except OSError as error:
            raise self._error(error, "describe") from error
        status, denied = bool(raw.caps & native.CAP_STATUS), bool(raw.caps & native.CAP_DENIED)
        readable = bool(raw.caps & native.CAP_READ)
        return IcapInfo(raw.word_bits, raw.clock_hz, raw.max_length, raw.idcode, status, denied, readable)

    def allocate(self, length: int) -> DmaBuffer:
        """Return a new buffer of at least ``length`` bytes that the port can load from."""
        try:
            raw = native.alloc(self._handle, length)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"allocate {length} bytes on") from error
        return DmaBuffer(raw, self._free, self.path)

    def import_buffer(self, fd: int) -> DmaBuffer:
        """Attach a foreign dma-buf; ``fd`` stays the caller's."""
        try:
            raw = native.import_fd(self._handle, fd)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"import descriptor {fd} into") from error
        return DmaBuffer(raw, self._free, self.path)

    def load(
        self,
        buffer: DmaBuffer,
        length: int | None = None,
        offset: int = 0,
        cookie: int = 0,
        full: bool = False,
        encrypted: bool = False,
    ) -> None:
        """Start a load of ``length`` bytes (whole words; default: the rest) and return at once.

        The words lie as the port takes them from a little-endian bus (sync word 66 55 99 AA in
        memory).  Raises DeviceBusy while any file loads, DeviceInvalid for a range that does not fit.
        """
        length = buffer.length - offset if length is None else length
        flags = (native.LOAD_FULL if full else 0) | (native.LOAD_ENCRYPTED if encrypted else 0)
        try:
            native.load(self._handle, buffer.handle, offset, length, cookie, flags)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"load {length} bytes at {offset} through") from error

    def read(self, buffer: DmaBuffer, request: slice, reply: slice, closing: slice, cookie: int = 0) -> None:
        """Start a read and return at once: its end comes as that of a load, ``length`` are the reply's bytes.

        The parts are slices of the buffer in bytes, whole words in the byte order of loads: what is written to the
        port first, where the words go that are read then, and what is written at the end, also after an error.
        Raises DeviceBusy while any file loads or reads, DeviceInvalid for parts that do not fit or overlap, and
        DeviceUnsupported where the port has no way back (`IcapInfo.readable`).
        """
        parts = (*_range(request), *_range(reply), *_range(closing))
        try:
            native.read_back(self._handle, buffer.handle, parts, cookie)
        except (OSError, OverflowError) as error:
            raise self._error(error, f"read {parts[3]} bytes through") from error

    def take(self) -> IcapCompletion | None:
        """Return the end of a load of this file if it came; never blocks."""
        try:
            raw = native.take(self._handle)
        except OSError as error:
            raise self._error(error, "take the completion of") from error
        return None if raw is None else _completion(raw)

    def wait(self, timeout: float | None = None) -> IcapCompletion:
        """Wait up to ``timeout`` seconds for the end of a load; DeviceTimeout.

        A load that failed is a completion with ``status`` and ``errors``, not an exception.
        """
        try:
            return _completion(native.wait_completion(self._handle, timeout))
        except OSError as error:
            raise self._error(error, "wait for a load through") from error

    def status(self) -> IcapStatus:
        """Return what the port does now."""
        try:
            raw = native.status(self._handle)
        except OSError as error:
            raise self._error(error, "ask the status of") from error
        return IcapStatus(IcapState(raw.state), _errors(raw.errors), raw.bytes_done, raw.bytes_total, raw.loads)

    def _free(self, handle: int) -> None:
        native.free(self._handle, handle)

# SPDX-License-Identifier: Apache-2.0
"""What all open devices share: a handle of the shim, a path for the messages, closing."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import ClassVar, Protocol, TypeVar

from cm.device import advice
from cm.device.errors import DeviceError, DeviceInvalid, device_error
from cm.device.native.call import Handle
from cm.device.paths import Root

Self = TypeVar("Self", bound="Device")
AnyRoot = str | os.PathLike[str] | Root | None


class Shim(Protocol):
    """What every device's module of `cm.device.native` has."""

    def release(self, handle: Handle) -> None: ...

    def event_fd(self, handle: Handle) -> int: ...


class Device:
    """An open device.

    Threads may share one: requests are serialised, waits are not, and ``close()`` by one thread
    ends the waits of the others with DeviceClosed.  Any use after ``close()`` raises DeviceClosed.
    """

    _shim: ClassVar[Shim]

    def __init__(self, handle: Handle, path: Path) -> None:
        """Take over an open handle; use ``open()`` instead."""
        self._handle = handle
        self._path = path

    @property
    def path(self) -> str:
        """The device's path, root included."""
        return str(self._path)

    def close(self) -> None:
        """Close the device; twice is fine.  Blocks until its driver has let go of it."""
        self._shim.release(self._handle)

    def fileno(self) -> int:
        """Return the descriptor that polls readable when an event waits; never read it."""
        try:
            return self._shim.event_fd(self._handle)
        except OSError as error:
            raise self._error(error, "poll") from error

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, exc: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._path}>"

    def _error(self, error: OSError | OverflowError, doing: str, hint: str = "") -> DeviceError:
        """Return the exception for what the shim raised while ``doing`` something."""
        if isinstance(error, OverflowError):
            return out_of_range(doing, self.path)
        return device_error(error, doing, self.path, hint)


def out_of_range(doing: str, path: str) -> DeviceInvalid:
    """Return the error for a number that the interface cannot carry."""
    return DeviceInvalid(errno.ERANGE, f"cannot {doing} {path}: a number is negative or too large", path)


def open_handle(
    opener: Callable[[str, str], Handle], root: Root, path: Path, name: str, present: Callable[[Root], Sequence[str]]
) -> Handle:
    """Open ``name`` with the shim's ``opener``; a refusal says what to do, naming what is ``present``."""
    try:
        return opener(root.prefix, name)
    except ValueError as error:
        raise device_error(errno.EINVAL, "open", repr(str(path)), "a name holds no NUL") from error
    except OSError as error:
        hint = advice.unopened(error, root, path, present(root))
        raise device_error(error, "open", str(path), hint) from error

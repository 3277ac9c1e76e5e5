# SPDX-License-Identifier: Apache-2.0
"""Turns errno into exceptions that are both ours and the builtin ones."""

from __future__ import annotations

import errno
import os
from typing import ClassVar

from cm.errors import Busy, CmError, InvalidRequest, Timeout


class DeviceError(CmError, OSError):
    """A device refused.  ``errno`` is the system's; ``str()`` is a sentence with the path in it."""

    code: ClassVar[str] = "device_error"

    def __str__(self) -> str:
        return self.strerror or super().__str__()


class DeviceNotFound(DeviceError, FileNotFoundError):
    """There is no such device, attribute or handle (ENOENT); the sentence lists what there is."""

    code = "device_not_found"


class DevicePermission(DeviceError, PermissionError):
    """The user may not open it (EACCES, EPERM); the sentence names the group."""

    code = "device_permission"


class DeviceBusy(DeviceError, Busy):
    """In use by another file, or a transfer is under way (EBUSY)."""

    code = "device_busy"


class DeviceTimeout(DeviceError, Timeout):
    """The wait ended without an event (ETIMEDOUT)."""

    code = "timeout"


class DeviceGone(DeviceError):
    """The device went away, or the simulated one has no server (ENODEV, ENXIO, EPIPE, ECONNRESET)."""

    code = "device_gone"


class DeviceClosed(DeviceError):
    """The object was closed before, or while it waited (EBADF, ECANCELED)."""

    code = "device_closed"


class DeviceRevoked(DeviceError):
    """A window's pages were taken back: what was read is not the register's value (ESTALE)."""

    code = "window_revoked"
    reason: int = 0  # a `cm.device.WindowEnd`


class DeviceExists(DeviceError, FileExistsError):
    """It is there already (EEXIST)."""

    code = "device_exists"


class DeviceInvalid(DeviceError, InvalidRequest):
    """The device refuses the values (EINVAL, ERANGE, EMSGSIZE, E2BIG); nothing was touched."""

    code = "device_invalid"


class DeviceUnsupported(DeviceError):
    """This kernel, driver or device cannot do that (ENOTSUP, ENOSYS, ENOTTY)."""

    code = "device_unsupported"


_KINDS: dict[int, type[DeviceError]] = {
    errno.ENOENT: DeviceNotFound,
    errno.EACCES: DevicePermission,
    errno.EPERM: DevicePermission,
    errno.EBUSY: DeviceBusy,
    errno.ETIMEDOUT: DeviceTimeout,
    errno.ENODEV: DeviceGone,
    errno.ENXIO: DeviceGone,
    errno.EPIPE: DeviceGone,
    errno.ECONNRESET: DeviceGone,
    errno.EBADF: DeviceClosed,
    errno.ECANCELED: DeviceClosed,
    errno.ESTALE: DeviceRevoked,
    errno.EEXIST: DeviceExists,
    errno.EINVAL: DeviceInvalid,
    errno.ERANGE: DeviceInvalid,
    errno.EMSGSIZE: DeviceInvalid,
    errno.E2BIG: DeviceInvalid,
    errno.EOPNOTSUPP: DeviceUnsupported,
    errno.ENOSYS: DeviceUnsupported,
    errno.ENOTTY: DeviceUnsupported,
}

_REASONS: dict[type[DeviceError], str] = {
    DeviceNotFound: "it does not exist",
    DevicePermission: "permission denied",
    DeviceBusy: "it is in use",
    DeviceTimeout: "it did not happen in time",
    DeviceGone: "the device has gone, or nothing serves it",
    DeviceClosed: "it is closed",
    DeviceRevoked: "its pages were taken back",
    DeviceExists: "it exists already",
}


def device_error(error: OSError | int, doing: str, path: str, advice: str = "") -> DeviceError:
    """Return the exception for an errno: ``cannot <doing> <path>: <reason>; <advice>``."""
    number = error if isinstance(error, int) else error.errno or errno.EIO
    kind = _KINDS.get(number, DeviceError)
    name = errno.errorcode.get(number, str(number))
    reason = _REASONS.get(kind) or os.strerror(number)
    sentence = f"cannot {doing} {path}: {reason} ({name})"
    return kind(number, f"{sentence}; {advice}" if advice else sentence, path)

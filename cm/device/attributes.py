# SPDX-License-Identifier: Apache-2.0
"""Attributes of sysfs and configfs under a root, with our errors."""

from __future__ import annotations

import errno
import os

from cm.device import advice
from cm.device.errors import DeviceError, device_error
from cm.device.native import attr as native
from cm.device.paths import Root
from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Attributes:
    """Reads and writes attributes in one folder under a root; stateless, so threads may share it."""

    root: Root
    folder: str

    def exists(self, name: str = "") -> bool:
        """Whether the attribute (or the folder itself) is there."""
        return os.path.exists(f"{self.root.prefix}/{self.folder}/{name}")  # noqa: PTH110 (a Path takes several times as long)

    def path(self, name: str = "") -> str:
        """Return the full path for messages."""
        return str(self.root.join(self.folder, name))

    def read(self, name: str) -> bytes:
        """Return the attribute's bytes."""
        try:
            return native.read(self.root.prefix, f"{self.folder}/{name}")
        except OSError as error:
            raise self._error(error, "read", name) from error

    def text(self, name: str) -> str:
        """Return the attribute as text without white space around it."""
        return self.read(name).decode("utf-8", "replace").strip()

    def write(self, name: str, data: bytes) -> None:
        """Write ``data`` in one go."""
        try:
            native.write(self.root.prefix, f"{self.folder}/{name}", data)
        except OSError as error:
            raise self._error(error, "write", name) from error

    def mkdir(self, name: str) -> None:
        """Make the folder ``name``."""
        try:
            native.mkdir(self.root.prefix, self.folder, name)
        except OSError as error:
            raise self._error(error, "make", name) from error

    def rmdir(self, name: str) -> None:
        """Remove the folder ``name``."""
        try:
            native.rmdir(self.root.prefix, self.folder, name)
        except OSError as error:
            raise self._error(error, "remove", name) from error

    def _error(self, error: OSError, doing: str, name: str) -> DeviceError:
        path = self.root.join(self.folder, name)
        hint = ""
        if error.errno in (errno.EACCES, errno.EPERM):
            hint = advice.permission(path)
        elif error.errno == errno.ENOENT:
            hint = advice.missing(path, advice.names(path.parent))
        elif error.errno == errno.ENODEV and self.root.simulated:
            hint = f"start the simulated board: cm sim --root {self.root.path}"
        return device_error(error, doing, str(path), hint)

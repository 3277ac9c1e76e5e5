# SPDX-License-Identifier: Apache-2.0
"""Paths of devices: all are relative to a root folder, ``CM_ROOT`` or ``/``."""

from __future__ import annotations

import os
from pathlib import Path

from cm.frozen import dataclass


@dataclass(frozen=True, slots=True)
class Root:
    """A folder in front of every device path.

    ``Root()`` is the real board; that of a simulated board is a folder on tmpfs.
    """

    path: str = "/"

    @classmethod
    def of(cls, root: str | os.PathLike[str] | Root | None) -> Root:
        """Return ``root`` as a Root; None is ``$CM_ROOT``, or else ``/``. The only place that reads the variable."""
        if isinstance(root, Root):
            return root
        text = os.environ.get("CM_ROOT") or "/" if root is None else os.fspath(root)
        return cls(str(Path(text).absolute()))

    @property
    def simulated(self) -> bool:
        """Whether this is not the file system's own root."""
        return self.path != "/"

    @property
    def prefix(self) -> str:
        """What the shim puts before ``/dev/…``."""
        return self.path.rstrip("/")

    def join(self, *parts: str) -> Path:
        """Return the path of ``parts`` under the root."""
        return Path(self.path, *parts)


class Standing:
    """A device's node or folder, as it was when this was made; no two devices have the same, one after the other.

    Its inode's number alone would do in sysfs; a simulated board may lie in a file system that uses numbers again.
    """

    def __init__(self, path: Path) -> None:
        """Look at it."""
        self._path = str(path)
        self._first = self._now()

    @property
    def stands(self) -> bool:
        """Whether it was there, and is the same."""
        return self._first is not None and self._now() == self._first

    def _now(self) -> tuple[int, int, int] | None:
        try:
            found = os.stat(self._path)  # noqa: PTH116 (by a Path it takes twice as long)
        except OSError:
            return None
        return found.st_dev, found.st_ino, found.st_ctime_ns

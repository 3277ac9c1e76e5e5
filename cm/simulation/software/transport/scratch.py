# SPDX-License-Identifier: Apache-2.0
"""Folders for the lifetime of a process; those of processes that were killed are removed by the next one.

The owner holds a lock on its folder, and the folder's name contains the owner's process id. What is removed belongs to
this user, is locked by nobody, and names a process that does not exist: a process id alone means nothing to processes
of another PID namespace, and a lock nothing in the instant before it is taken.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import ExitStack, suppress
from pathlib import Path

LOCK = ".cm-sim.lock"  # of the simulator that serves a folder, which may outlive the folder's owner


def default_parent() -> Path:
    """A folder in memory: /dev/shm, else $XDG_RUNTIME_DIR, else the temporary folder."""
    for candidate in ("/dev/shm", os.environ.get("XDG_RUNTIME_DIR")):
        if candidate and os.access(candidate, os.W_OK | os.X_OK):
            return Path(candidate)
    return temporary()


def temporary() -> Path:
    """The folder for temporary files. That module is 1 MiB with what it imports."""
    import tempfile

    return Path(tempfile.gettempdir())


def remove(folder: Path) -> None:
    """Remove a folder and everything in it, as far as that is allowed; links are not followed."""
    import shutil

    shutil.rmtree(folder, ignore_errors=True)


class Scratch:
    """A new folder of this process, readable by this user only. As a context manager it gives its path."""

    def __init__(self, prefix: str, parent: Path | None = None) -> None:
        """`parent`: default_parent() if None. Raises OSError."""
        parent = parent or default_parent()
        sweep(prefix, parent)
        while True:
            self.path = parent / f"{prefix}{os.getpid()}-{os.urandom(8).hex()}"
            self.path.mkdir(mode=0o700)
            self._lock = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            fcntl.flock(self._lock, fcntl.LOCK_EX)
            if self.path.is_dir():
                return
            os.close(self._lock)  # removed by another process before it was locked

    def close(self) -> None:
        """Remove the folder and everything in it; twice is fine."""
        if self._lock >= 0:
            remove(self.path)
            os.close(self._lock)
            self._lock = -1

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.close()


def sweep(prefix: str, parent: Path) -> None:
    """Remove the folders of that prefix whose owners were killed."""
    for path in parent.glob(f"{prefix}*-*"):
        owner = path.name[len(prefix) :].partition("-")[0]
        if owner.isdecimal() and not _exists(int(owner)):
            with suppress(OSError):
                _remove_unless_used(path)


def _remove_unless_used(path: Path) -> None:
    """Raises OSError where it is a link, locked, or has gone meanwhile."""
    with ExitStack() as stack:
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
        stack.callback(os.close, folder)
        if os.fstat(folder).st_uid != os.getuid():
            return
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with suppress(FileNotFoundError):
            served = os.open(LOCK, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, dir_fd=folder)
            stack.callback(os.close, served)
            fcntl.flock(served, fcntl.LOCK_EX | fcntl.LOCK_NB)
        remove(path)


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OverflowError, PermissionError):
        pass
    return True

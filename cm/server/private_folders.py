# SPDX-License-Identifier: Apache-2.0
"""Folders that must be ours, so that no other user can place files or links there that we would open; their locks."""

from __future__ import annotations

import fcntl
import os
import stat
from contextlib import suppress
from pathlib import Path

from cm.device.base import AnyRoot
from cm.device.paths import Root
from cm.errors import Busy, CmError

FOLDER_MODE, SOCKET_MODE = 0o750, 0o660


class UnsafeFolder(CmError, PermissionError):
    """A folder that another user could have prepared."""

    code = "unsafe_folder"


def own_folder(folder: Path, group: int | None = None, mode: int = FOLDER_MODE) -> None:
    """Make a folder if there is none; with a group, give it to that.

    Raises UnsafeFolder if it is not ours. Ours is one that belongs to this user (or to root, who can do anything
    anyway), is not a link, and cannot be written by others; by its group only if it is sticky. A link further up is
    followed only if everything above it is safe too: /var/run is one on most systems.
    """
    with suppress(FileExistsError):  # a file: opening it says so
        folder.mkdir(mode=mode, parents=True, exist_ok=True)
    fd = _opened(folder)
    try:
        status = os.fstat(fd)
        if status.st_uid not in (os.geteuid(), 0):
            raise UnsafeFolder(f"{folder} belongs to user {status.st_uid}, not to this one ({os.geteuid()})")
        if status.st_mode & stat.S_IWOTH:
            raise UnsafeFolder(f"{folder} can be written by everybody: chmod o-w {folder}, or choose another")
        if status.st_mode & stat.S_IWGRP and not status.st_mode & stat.S_ISVTX:
            raise UnsafeFolder(
                f"{folder} can be written by its group ({status.st_gid}), whose members could put a socket there "
                f"and be the manager: chmod g-w {folder}, or chmod +t {folder} if they have to write there"
            )
        if group is not None and (status.st_gid != group or not status.st_mode & stat.S_IXGRP):
            _give(fd, folder, group, stat.S_IMODE(status.st_mode) | 0o050)
    finally:
        os.close(fd)


def _give(fd: int, folder: Path, group: int, mode: int) -> None:
    try:
        os.fchown(fd, -1, group)
        os.fchmod(fd, mode)
    except PermissionError:
        raise UnsafeFolder(
            f"{folder} cannot be given to group {group}: only root, and members of it, can do that"
        ) from None


def _opened(folder: Path) -> int:
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        return os.open(folder, flags)
    except NotADirectoryError:
        if folder.is_symlink():
            raise UnsafeFolder(f"{folder} is not a folder, or a link to one: name the folder itself") from None
        raise UnsafeFolder(
            f"{folder} is a file, not a folder: name a folder; one that does not exist yet is made"
        ) from None


def open_inside(folder: Path, name: str, flags: int, mode: int = 0o640) -> int:
    """Open a file of a folder, following no link at its end. Raises UnsafeFolder for one, OSError."""
    try:
        fd = os.open(folder / name, flags | os.O_NOFOLLOW | os.O_CLOEXEC, mode)
    except OSError as error:
        if not (folder / name).is_symlink():
            raise
        raise UnsafeFolder(f"{folder / name} is a link; what it leads to is left alone") from error
    if not stat.S_ISREG(os.fstat(fd).st_mode):
        os.close(fd)
        raise UnsafeFolder(f"{folder / name} is not a file")
    return fd


def share(path: Path, group: int | None) -> None:
    """Open a socket in our folder to this user and a group."""
    if group is not None:
        os.chown(path, -1, group, follow_symlinks=False)
    path.chmod(SOCKET_MODE)


class AlreadyServed(Busy):
    """Another manager serves this runtime folder."""

    code = "already_served"


class FolderLock:
    """An flock on the runtime folder: it ends with the process, however that dies."""

    def __init__(self, folder: Path, group: int | None = None) -> None:
        """Make the folder, for this user and a group. Raises UnsafeFolder for one that is not ours."""
        own_folder(folder, group)
        self._fd = open_inside(folder, "lock", os.O_RDWR | os.O_CREAT)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            pid = os.read(self._fd, 32).decode("ascii", "replace").strip()
            os.close(self._fd)
            raise AlreadyServed(
                f"a configuration manager (pid {pid}) serves {folder} already; stop it, or choose another --runtime-dir"
            ) from None
        os.ftruncate(self._fd, 0)
        os.write(self._fd, str(os.getpid()).encode())

    def release(self) -> None:
        """Give it back."""
        os.close(self._fd)


class BoardLock:
    """An flock on the board's sysfs: managers with other runtime folders notice each other.

    Nothing is written. It ends with the process, and holds within one mount of sysfs: managers in containers with
    mounts of their own do not see it.
    """

    def __init__(self, root: AnyRoot) -> None:
        folder = Root.of(root).join("sys")
        if not folder.is_dir():
            folder = folder.parent
        self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = _holder(self._fd)
            os.close(self._fd)
            raise AlreadyServed(
                f"{holder} holds the board below {folder.parent} already: two managers would load over each other. "
                "Stop it, or give each a board of its own (CM_ROOT)"
            ) from None

    def release(self) -> None:
        """Give it back."""
        os.close(self._fd)


class Locks:
    """Both, held until `release`. Raises AlreadyServed."""

    def __init__(self, folder: Path, root: AnyRoot, group: int | None = None) -> None:
        self._folder = FolderLock(folder, group)
        try:
            self._board = BoardLock(root)
        except BaseException:
            self._folder.release()
            raise

    def release(self) -> None:
        """Give them back."""
        self._board.release()
        self._folder.release()


def _holder(fd: int) -> str:
    """The holder of an flock on a file, as /proc/locks has it."""
    wanted = os.fstat(fd).st_ino
    try:
        lines = Path("/proc/locks").read_text("ascii", "replace").splitlines()
    except OSError:
        lines = []
    for fields in (line.split() for line in lines):
        if len(fields) >= 6 and fields[1] == "FLOCK" and fields[5].rpartition(":")[2] == str(wanted):
            return f"another process (pid {fields[4]})"
    return "another process"

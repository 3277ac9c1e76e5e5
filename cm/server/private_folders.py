# SPDX-License-Identifier: Apache-2.0
"""Folders that must be ours, so that no other user can place files or links there that we would open; their locks."""

from __future__ import annotations

import errno
import fcntl
import grp
import os
import pwd
import stat
from contextlib import suppress
from pathlib import Path

from cm.device.base import AnyRoot
from cm.device.paths import Root
from cm.errors import Busy, CmError

SOCKET_MODE = 0o660


class UnsafeFolder(CmError, PermissionError):
    """A folder that another user could have prepared."""

    code = "unsafe_folder"


def own_folder(folder: Path, group: int | None = None, mode: int = 0o700) -> None:
    """Make a folder if there is none, whatever the umask; with a group, let that in.

    Raises UnsafeFolder if it is not ours, or another user could put one of his own in its place. Each part of its path
    is judged, as sshd does: it belongs to this user (or to root, who can do anything anyway), and nobody else may
    write there; above the folder itself all may where it is sticky, as /tmp. A link is followed above it only.
    """
    _make_and_judge(folder.absolute(), mode)
    status = folder.stat()
    if group is not None and (status.st_gid != group or not status.st_mode & stat.S_IXGRP):
        try:
            os.chown(folder, -1, group)
            folder.chmod(stat.S_IMODE(status.st_mode) | 0o050)
        except PermissionError:
            raise UnsafeFolder(
                f"{folder} cannot be given to group {group}: only root, and members of it, can do that"
            ) from None


def private_folder(folder: Path) -> None:
    """As `own_folder`, for what nobody else may even read, or hold a lock on. Raises UnsafeFolder, OSError."""
    own_folder(folder)
    if folder.stat().st_mode & 0o077:
        try:
            folder.chmod(0o700)
        except OSError as error:
            if error.errno != errno.EROFS:  # a disk that fails is served from, as it is
                raise


def _make_and_judge(path: Path, mode: int | None) -> None:
    """Raise UnsafeFolder for a path that another user may change, from the root on: what was judged stays as it was.

    `mode`: of the folder itself; None: it is passed through, and may be a link of ours or of root's.
    """
    if path != path.parent:
        _make_and_judge(path.parent, None)
    if path.is_symlink():
        if mode is not None or path.lstat().st_uid not in (os.geteuid(), 0) or not path.is_dir():
            raise UnsafeFolder(f"{path} is not a folder, or a link to one: name the folder itself")
        _make_and_judge(path.parent / path.readlink(), None)
        return
    with suppress(FileExistsError):
        path.mkdir(0o755 if mode is None else 0o700)
        if mode is not None:
            path.chmod(mode)
    status = path.lstat()
    sticky = status.st_mode & stat.S_ISVTX
    if not stat.S_ISDIR(status.st_mode):
        raise UnsafeFolder(f"{path} is a file, not a folder: name a folder; one that does not exist yet is made")
    if status.st_uid not in (os.geteuid(), 0):
        raise UnsafeFolder(f"{path} belongs to user {status.st_uid}, not to this one ({os.geteuid()})")
    if status.st_mode & stat.S_IWOTH and (mode is not None or not sticky):
        raise UnsafeFolder(f"{path} can be written by everybody: chmod o-w {path}, or choose another")
    if status.st_mode & stat.S_IWGRP and not sticky and not is_private_group(status.st_gid, status.st_uid):
        raise UnsafeFolder(
            f"{path} can be written by its group ({status.st_gid}), whose members could put a socket there "
            f"and be the manager: chmod g-w {path}, or chmod +t {path} if they have to write there"
        )


def is_private_group(gid: int, uid: int) -> bool:
    """Whether a group lets nobody in but one user: its primary one, of its name or number, and nobody else's."""
    try:
        user, group = pwd.getpwuid(uid), grp.getgrgid(gid)
    except KeyError:
        return False
    named = user.pw_gid == gid and (group.gr_name == user.pw_name or gid == uid)
    return named and {*group.gr_mem, *(u.pw_name for u in pwd.getpwall() if u.pw_gid == gid)} <= {user.pw_name}


def open_inside(folder: Path, name: str, flags: int, mode: int = 0o600) -> int:
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


def share(path: Path, group: int | None, mode: int = SOCKET_MODE) -> None:
    """Open a socket, or a file, in our folder to this user and a group."""
    if group is not None:
        os.chown(path, -1, group, follow_symlinks=False)
    path.chmod(mode)


class AlreadyServed(Busy):
    """Another manager serves this runtime folder."""

    code = "already_served"


class _Lock:
    """An flock on an open file: it ends with the process, however that dies. Raises AlreadyServed."""

    def __init__(self, fd: int, refused: str) -> None:
        self._fd = fd
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            holder = _holder(fd)
            os.close(fd)
            raise AlreadyServed(f"{holder} {refused}") from None

    def release(self) -> None:
        """Give it back."""
        os.close(self._fd)


class FolderLock(_Lock):
    """The lock of a runtime folder."""

    def __init__(self, folder: Path, group: int | None = None) -> None:
        """Make the folder, for this user and a group. Raises UnsafeFolder for one that is not ours."""
        own_folder(folder, group)
        fd = open_inside(folder, "lock", os.O_RDWR | os.O_CREAT)
        os.fchmod(fd, 0o600)  # who can open it can hold it
        super().__init__(fd, f"serves {folder} already; stop it, or choose another --runtime-dir")


_ROOTS_ALONE = "firmware/fdt"  # mode 0400 on every machine with a device tree


class BoardLock(_Lock):
    """One on a file of the board's sysfs: managers with other runtime folders notice each other.

    Nothing is written. It holds within one mount of sysfs: managers in containers with mounts of their own do not see
    it. The file is one that only root may read, or who has the capability that loading takes: others could hold what
    they can open. Where there is none, or we may not, it is the folder.
    """

    def __init__(self, root: AnyRoot) -> None:
        folder = Root.of(root).join("sys")
        if not folder.is_dir():
            folder = folder.parent
        try:
            fd = os.open(folder / _ROOTS_ALONE, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        super().__init__(
            fd,
            f"holds the board below {folder.parent} already: two managers would load over each other. "
            "Stop it, or give each a board of its own (CM_ROOT)",
        )


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

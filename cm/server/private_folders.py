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
_PART = os.O_PATH | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_LINKS = 40  # in a path, as the kernel follows


class UnsafeFolder(CmError, PermissionError):
    """A folder that another user could have prepared."""

    code = "unsafe_folder"


def own_folder(folder: Path, group: int | None = None, mode: int = 0o700) -> None:
    """Make a folder if there is none, whatever the umask; with a group, let that in.

    Raises UnsafeFolder if it is not ours, or another user could put one of his own in its place. Each part of its path
    is judged, as sshd does: it belongs to this user (or to root, who can do anything anyway), and nobody else may
    write there; above the folder itself all may where it is sticky, as /tmp. A link is followed above it only.
    """
    fd = _opened(folder, mode)
    try:
        status = os.fstat(fd)
        if group is not None and (status.st_gid != group or not status.st_mode & stat.S_IXGRP):
            _give(fd, folder, group, stat.S_IMODE(status.st_mode) | 0o050)
    finally:
        os.close(fd)


def private_folder(folder: Path) -> None:
    """As `own_folder`, for what nobody else may even read, or hold a lock on. Raises UnsafeFolder, OSError."""
    own_folder(folder)
    if folder.stat().st_mode & 0o077:
        try:
            folder.chmod(0o700)
        except OSError as error:
            if error.errno != errno.EROFS:  # a disk that fails is served from, as it is
                raise


def _give(fd: int, folder: Path, group: int, mode: int) -> None:
    try:
        os.fchown(fd, -1, group)
        os.fchmod(fd, mode)
    except PermissionError:
        raise UnsafeFolder(
            f"{folder} cannot be given to group {group}: only root, and members of it, can do that"
        ) from None


def _opened(folder: Path, mode: int) -> int:
    """Open a folder part by part, by descriptors: what was judged is what the next part is looked up in."""
    path, rest, links = Path("/"), [*reversed(folder.absolute().parts[1:])], 0
    at = os.open(path, _PART)
    try:
        _judge(at, path, last=not rest)
        while rest:
            name = rest.pop()
            path /= name
            try:
                below = _part(at, name, mode if not rest else None)
            except OSError as error:
                error.filename = str(path)
                target = _link(at, name)
                if not target or not rest or (links := links + 1) > _LINKS:
                    raise _refused(path, error, target is not None) from None
                path = Path("/") if target.startswith("/") else path.parent
                below = os.open(path if target.startswith("/") else ".", _PART, dir_fd=at)
                rest += [part for part in reversed(Path(target).parts) if part != "/"]
            os.close(at)
            at = below
            _judge(at, path, last=not rest)
    except BaseException:
        os.close(at)
        raise
    return at


def _part(at: int, name: str, mode: int | None) -> int:
    """A folder in a folder, made where it is missing: with this mode, or as one to pass through."""
    flags = _PART if mode is None else _PART & ~os.O_PATH
    try:
        return os.open(name, flags, dir_fd=at)
    except FileNotFoundError:
        with suppress(FileExistsError):
            os.mkdir(name, 0o755 if mode is None else 0o700, dir_fd=at)
            made = os.open(name, flags, dir_fd=at)
            if mode is not None:
                os.fchmod(made, mode)
            return made
        return os.open(name, flags, dir_fd=at)


def _link(at: int, name: str) -> str | None:
    """Where a link of ours or root's leads; None for what is none."""
    try:
        target = os.readlink(name, dir_fd=at)
        owner = os.stat(name, dir_fd=at, follow_symlinks=False).st_uid
    except OSError:
        return None
    return target if owner in (os.geteuid(), 0) else ""


def _refused(path: Path, error: OSError, is_link: bool) -> OSError:
    if is_link:
        return UnsafeFolder(f"{path} is not a folder, or a link to one: name the folder itself")
    if isinstance(error, NotADirectoryError):
        return UnsafeFolder(f"{path} is a file, not a folder: name a folder; one that does not exist yet is made")
    return error


def _judge(fd: int, path: Path, last: bool) -> None:
    """Raise UnsafeFolder for a part of a path that another user may change."""
    status = os.fstat(fd)
    sticky = status.st_mode & stat.S_ISVTX
    if status.st_uid not in (os.geteuid(), 0):
        raise UnsafeFolder(f"{path} belongs to user {status.st_uid}, not to this one ({os.geteuid()})")
    if status.st_mode & stat.S_IWOTH and (last or not sticky):
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


class FolderLock:
    """An flock on the runtime folder: it ends with the process, however that dies."""

    def __init__(self, folder: Path, group: int | None = None) -> None:
        """Make the folder, for this user and a group. Raises UnsafeFolder for one that is not ours."""
        own_folder(folder, group)
        self._fd = open_inside(folder, "lock", os.O_RDWR | os.O_CREAT)
        os.fchmod(self._fd, 0o600)  # who can open it can hold it
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


_ROOTS_ALONE = "firmware/fdt"  # mode 0400 on every machine with a device tree


class BoardLock:
    """An flock on a file of the board's sysfs: managers with other runtime folders notice each other.

    Nothing is written. It ends with the process, and holds within one mount of sysfs: managers in containers with
    mounts of their own do not see it. The file is one that only root may read, or who has the capability that loading
    takes: others could hold what they can open. Where there is none, or we may not, it is the folder.
    """

    def __init__(self, root: AnyRoot) -> None:
        folder = Root.of(root).join("sys")
        if not folder.is_dir():
            folder = folder.parent
        try:
            self._fd = os.open(folder / _ROOTS_ALONE, os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
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

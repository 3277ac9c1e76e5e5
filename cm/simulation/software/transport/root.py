# SPDX-License-Identifier: Apache-2.0
"""The folder that a simulated board serves: lock, plain files, sockets, and their removal.

A lock file shows whether a simulator is alive. Whatever is made is listed in a manifest beside it, so that a
simulator that starts where another was killed removes what that one left, and nothing else.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import socket
from collections.abc import Sequence
from pathlib import Path

from cm.errors import sentence
from cm.simulation.software.errors import NodeError, SimError
from cm.simulation.software.transport.scratch import LOCK, Scratch

MANIFEST = ".cm-sim.made"
_NEW = ".cm-sim.new"  # a file that is not whole yet
_FRESH = "cm-simulator-"  # roots that a simulator has made for itself
_BACKLOG = 32


class Root:
    """A locked root; `close()` removes everything that was made in it."""

    def __init__(self, path: Path | None) -> None:
        """Create and lock `path` (None: a fresh folder in memory).

        Raises:
            SimError: another simulator is alive there, or the folder cannot be made.
        """
        self._made: dict[str, None] = {}  # in this order
        self._own = False
        self._fresh: Scratch | None = None
        try:
            self.path = self._create(path)
            self._lock = self._acquire()
            self._dir = os.open(self.path, os.O_PATH | os.O_DIRECTORY)
            self._remove_leftovers()
            self._manifest = open(self.path / MANIFEST, "w", encoding="utf-8", opener=_for_us)  # noqa: SIM115
            self._manifest.write(".\n" if self._own else "")
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            advice = "free some space there, or give a folder elsewhere" if full else "give a folder you may write"
            raise SimError(f"the root {path or 'in memory'} cannot be used: {sentence(error)}; {advice}") from error

    def mkdir(self, relative: str) -> None:
        """Make a folder and those above it."""
        if (self.path / relative).is_dir():
            return
        done = ""
        for part in relative.split("/"):
            done = f"{done}/{part}" if done else part
            target = self.path / done
            if not target.is_dir():
                self._record(done)
                target.mkdir(0o755)

    def write(self, relative: str, data: str | bytes) -> None:
        """Write a plain file, replacing it as a whole."""
        if relative not in self._made:
            self._parent(relative)
            self._record(relative)
        path = self.path / _NEW
        left = memoryview(data.encode() if isinstance(data, str) else data)
        new = _for_us(str(path), os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC)
        try:
            while left:
                left = left[os.write(new, left) :]
        finally:
            os.close(new)
        path.replace(self.path / relative)

    def link(self, relative: str, to: str) -> None:
        """A symbolic link."""
        self._parent(relative)
        self._record(relative)
        (self.path / relative).symlink_to(to)

    def remove(self, relative: str) -> None:
        """Remove what was made, if it is there: a file, or a folder that is empty."""
        _remove(self.path / relative)
        self._made.pop(relative, None)

    def bind(self, relative: str) -> socket.socket:
        """A listening seqpacket socket at a path of any length."""
        self._parent(relative)
        target = self.path / relative
        with contextlib.suppress(FileNotFoundError):
            target.unlink()
        self._record(relative)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        os.fchmod(listener.fileno(), 0o600)  # before it is bound: whatever the umask, nobody else is the board's user
        folder = os.open(target.parent, os.O_PATH | os.O_DIRECTORY)
        try:
            listener.bind(f"/proc/self/fd/{folder}/{target.name}")
        finally:
            os.close(folder)
        listener.listen(_BACKLOG)
        return listener

    def firmware(self, name: str) -> bytes:
        """A file below lib/firmware, as the kernel's request_firmware finds it (ENOENT)."""
        path = Path(name)
        try:
            if path.is_absolute() or ".." in path.parts or not name:
                raise FileNotFoundError(name)
            return (self.path / "lib/firmware" / path).read_bytes()
        except (OSError, ValueError):  # ValueError: a NUL in the name
            raise NodeError(errno.ENOENT, f"no firmware {name!r}") from None

    def move(self, folder: str, to: str, files: Sequence[str]) -> None:
        """Give a folder made here another place, with the files that were made in it."""
        self._record(to, *[f"{to}/{name}" for name in files])
        (self.path / folder).rename(self.path / to)
        for made in (folder, *[f"{folder}/{name}" for name in files]):
            del self._made[made]

    def close(self) -> None:
        """Remove what was made, the lock last."""
        for relative in reversed(self._made):
            _remove(self.path / relative)
        self._made.clear()
        self._manifest.close()
        for name in (MANIFEST, _NEW, LOCK):
            _remove(self.path / name)
        os.close(self._lock)
        os.close(self._dir)
        if self._fresh is not None:
            self._fresh.close()  # the folder is ours alone, so what clients wrote goes too
        elif self._own:
            _remove(self.path)

    def _create(self, path: Path | None) -> Path:
        if path is None:
            self._own, self._fresh = True, Scratch(_FRESH)
            return self._fresh.path
        if not path.is_dir():
            path.mkdir(0o755, parents=True)
            self._own = True
        return path.absolute()

    def _acquire(self) -> int:
        while True:
            fd = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                owner = os.read(fd, 32).decode("ascii", "replace").strip()
                os.close(fd)
                raise SimError(
                    f"another simulator (process {owner or 'unknown'}) serves {self.path}; "
                    "stop it or choose another --root"
                ) from None
            if _same_file(fd, self.path / LOCK):
                os.ftruncate(fd, 0)
                os.write(fd, str(os.getpid()).encode())
                return fd
            os.close(fd)  # its owner removed it between our open and our lock

    def _remove_leftovers(self) -> None:
        manifest = self.path / MANIFEST
        _remove(self.path / _NEW)
        if not manifest.exists():
            return
        for relative in reversed(manifest.read_text("utf-8").splitlines()):
            if relative == ".":
                self._own = True
            elif relative and not relative.startswith("/") and ".." not in relative.split("/"):
                _remove(self.path / relative)

    def _parent(self, relative: str) -> None:
        folder = relative.rpartition("/")[0]
        if folder:
            self.mkdir(folder)

    def _record(self, *names: str) -> None:
        self._made.update(dict.fromkeys(names))
        self._manifest.write("".join(f"{name}\n" for name in names))
        self._manifest.flush()


def _for_us(path: str, flags: int) -> int:
    return os.open(path, flags, 0o644)  # that others write to no file, under a umask of 0007 too


def _same_file(fd: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(fd), path.stat())
    except FileNotFoundError:
        return False


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except IsADirectoryError:
        with contextlib.suppress(OSError):
            path.rmdir()
    except OSError:
        pass

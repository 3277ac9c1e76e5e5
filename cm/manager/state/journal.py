# SPDX-License-Identifier: Apache-2.0
"""The record on disk: written before each step, read after a crash.

A journal of one line per record, of which the last whole one counts. A line is a single pwrite(2), so a killed manager
leaves whole lines and at most one torn end. The file has its full length from the beginning, and so has the one that
will replace it (by a rename) when it is full: a disk that others have filled does not prevent a change of mode. There
is no fsync: after a loss of power the device is empty too, and the boot id shows that.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path

from cm.manager.errors import StateInUse, StoreCorrupt
from cm.manager.state.record import OtherVersion, Pending, Record, encode, newest

__all__ = ["Journal", "Pending", "Record"]

LENGTH = 256 * 1024  # bytes of a journal


class Journal:
    """The journal in a folder, which it holds a lock on. Raises StateInUse, OSError."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / "journal"
        self._lock = _locked(folder)
        self._spare = -1
        try:
            self._fd = _open(self._path)
        except OSError:
            os.close(self._lock)
            raise
        self._begin()

    def _begin(self) -> None:
        self._at = _end(self._path)  # where the next line goes
        _reserve(self._fd)
        self._old.unlink(missing_ok=True)
        self._renew_spare()

    def write(self, record: Record) -> None:
        """Add a record; it survives the death of this process from here on. Raises OSError."""
        line = encode(record)
        if self._at + len(line) > LENGTH:
            self._rotate(line)
        else:
            self._put(self._fd, line, self._at)
            self._at += len(line)

    def _put(self, descriptor: int, line: bytes, at: int) -> None:
        if os.pwrite(descriptor, line, at) != len(line):
            raise OSError(errno.ENOSPC, f"state record {self._path} could not be written whole: is the disk full?")

    def _rotate(self, line: bytes) -> None:
        if self._spare < 0:
            self._spare = _open(self._new)
            os.ftruncate(self._spare, 0)
        self._put(self._spare, line, 0)
        kept = self._keep_old()
        self._new.replace(self._path)
        old, self._fd, self._spare = self._fd, self._spare, -1
        self._at = len(line)
        self._renew_spare(old if kept else -1)
        if self._spare != old:
            os.close(old)

    def _keep_old(self) -> bool:
        """Give the journal a second name, so that its space is not lost to others when the first name goes."""
        with contextlib.suppress(OSError):
            os.link(self._path, self._old)
            return True
        return False

    def _renew_spare(self, old: int = -1) -> None:
        """A file of full length, to be the next journal: the old one, or a new one.

        Without room for it, it is tried again when it is needed.
        """
        with contextlib.suppress(OSError):
            if old >= 0:
                self._old.replace(self._new)
                os.ftruncate(old, LENGTH)
                os.pwrite(old, bytes(LENGTH), 0)
                self._spare = old
                return
            self._new.unlink(missing_ok=True)
            self._spare = _open(self._new)
            _reserve(self._spare)

    @property
    def _new(self) -> Path:
        return self._path.with_suffix(".new")

    @property
    def _old(self) -> Path:
        return self._path.with_suffix(".old")

    def read(self) -> Record | None:
        """The last whole record; None if there is none yet.

        Raises StoreCorrupt where the file cannot be read, holds lines but no good one, or the last good
        one is of another version; it is set aside first.
        """
        try:
            data = self._path.read_bytes()
            record = newest(data)
        except OSError as error:
            raise StoreCorrupt(f"the state record {self._path} cannot be read ({error})") from error
        except OtherVersion:
            raise StoreCorrupt(
                f"the state record {self._path} is of another version of this program; {self._aside()}"
            ) from None
        if record is None and data.strip(b"\0\n "):
            raise StoreCorrupt(f"the state record {self._path} holds no whole line; {self._aside()}")
        return record

    def _aside(self) -> str:
        """Begin a new journal; returns a sentence on what became of the old one."""
        aside = self._path.with_suffix(".corrupt")
        try:
            self._path.replace(aside)
            new = _open(self._path)
        except OSError as error:
            return f"it could not be set aside ({error})"
        os.close(self._fd)
        self._fd, self._at = new, 0
        _reserve(self._fd)
        return f"it was moved to {aside}"

    def close(self) -> None:
        """Close the files and give the lock back; twice is fine."""
        for descriptor in (self._fd, self._spare, self._lock):
            if descriptor >= 0:
                os.close(descriptor)
        self._fd = self._spare = self._lock = -1


def _open(path: Path) -> int:
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o640)


def _end(path: Path) -> int:
    try:
        return len(path.read_bytes().rstrip(b"\0"))
    except OSError:  # `read` will say so; what is written next goes to a new file
        return LENGTH


def _reserve(descriptor: int) -> None:
    """Room for a whole journal, as far as the file system can promise it."""
    with contextlib.suppress(OSError):
        os.posix_fallocate(descriptor, 0, LENGTH)


def _locked(folder: Path) -> int:
    """An flock on the folder: it ends with the process, however that dies. Raises StateInUse."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            raise
        raise StateInUse(
            f"another configuration manager keeps its state in {folder}; stop it, or choose another --state-dir"
        ) from None
    return descriptor

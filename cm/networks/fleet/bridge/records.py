# SPDX-License-Identifier: Apache-2.0
"""Records of changes on disk: a file for each, replaced in one step and synced before anything relies on it."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from cm.errors import InvalidRequest
from cm.networks.fleet.change import member
from cm.wire.fleet_records import decode_record, encode_record
from cm.wire.messages.fleet import FleetRecord

KEPT = 1000  # records that are kept, for boards that were away for long and ask what was decided
_LAST = "last"


class Records:
    """The records of one board, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._folder = folder
        self._last = self._read_last()

    def read(self, change: str) -> FleetRecord | None:
        """The record of a change; None if there is none, or it is damaged."""
        try:
            return decode_record(self._path(change).read_bytes())
        except (FileNotFoundError, InvalidRequest):
            return None

    def last(self) -> FleetRecord | None:
        """The record of the last change that the board took part in."""
        return self._last

    def write(self, record: FleetRecord) -> None:
        """Returns when it is on the disk. Raises OSError; then the old one is still whole."""
        own = record.state != member.OPEN
        if own and (self._last is None or self._last.id != record.id):  # first: a record that cannot be found is lost
            self._put(_LAST, record.id.encode())
        if not self._path(record.id).exists():
            self._forget(record.id if own or self._last is None else self._last.id)
        self._put(f"{record.id}.record", encode_record(record))
        if own:
            self._last = record

    def lease(self, change: str) -> str:
        """The lease that was taken for a change, empty if none was."""
        try:
            return (self._folder / f"{change}.lease").read_text(encoding="utf-8")
        except FileNotFoundError:
            return ""

    def keep_lease(self, change: str, lease: str) -> None:
        """Keep the lease, so that the next process can give it back or use it again."""
        if lease:
            self._put(f"{change}.lease", lease.encode())
        else:
            (self._folder / f"{change}.lease").unlink(missing_ok=True)

    def _read_last(self) -> FleetRecord | None:
        try:
            return self.read((self._folder / _LAST).read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None

    def _put(self, name: str, data: bytes) -> None:
        handle, path = tempfile.mkstemp(prefix=".new-", dir=self._folder)  # mode 0600
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(path).rename(self._folder / name)
        except BaseException:
            Path(path).unlink(missing_ok=True)
            raise
        folder = os.open(self._folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _path(self, change: str) -> Path:
        return self._folder / f"{change}.record"

    def _forget(self, last: str) -> None:
        """Delete the oldest beyond those that are kept; never that of the last change the board takes part in."""
        files = sorted(self._folder.glob("*.record"), key=lambda path: path.stat().st_mtime_ns)
        for path in files[:-KEPT]:
            if path != self._path(last):
                path.unlink(missing_ok=True)

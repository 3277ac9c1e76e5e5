# SPDX-License-Identifier: Apache-2.0
"""What a board of a fleet writes to its disk: its notes."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

from cm.networks.fleet.reconciling_board import Notes, Part
from cm.wire.messages.status import ErrorInfo


class NotesFile:
    """A board's notes, replaced in one step; whole after a kill.

    Nothing is synced: a loss of power takes what the hardware held, and what was noted of it means nothing any more.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path, self._new = folder / "notes.json", folder / ".notes.new"

    def read(self) -> Notes:
        """What was written last; nothing, if that is damaged or of another version."""
        try:
            return unpacked(self._path.read_bytes())
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return Notes()

    def write(self, notes: Notes) -> None:
        """By system calls: what a buffered file adds takes longer than they do, four times a change."""
        data, new = packed(notes), os.open(self._new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        try:
            if os.write(new, data) != len(data):
                raise OSError(errno.ENOSPC, f"{self._new} could not be written whole: is the disk full?")
        finally:
            os.close(new)
        self._new.replace(self._path)


def packed(notes: Notes) -> bytes:
    """As they lie on the disk."""
    return json.dumps(notes, default=lambda each: {name: getattr(each, name) for name in each.__slots__}).encode()


def unpacked(data: bytes) -> Notes:
    """The inverse of `packed`. Raises ValueError, KeyError, TypeError."""
    plain = json.loads(data)
    part = plain["part"]
    if part is not None:
        error = ErrorInfo(**part["error"]) if part["error"] else None
        part = Part(**{**part, "old": tuple(part["old"]), "goal": tuple(part["goal"]), "error": error})
    return Notes(**{**plain, "place": tuple(plain["place"]), "part": part})

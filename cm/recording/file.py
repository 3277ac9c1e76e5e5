# SPDX-License-Identifier: Apache-2.0
"""One file of a record, written with foxglove-sdk.

The library says nothing of a disk that is full: it goes on, and only its `flush` fails, without the reason. So it
writes through `_Sink`, which knows. Each of its chunks reaches the disk in one piece, with its length and its CRC, as
it is told not to seek.
"""

from __future__ import annotations

import os
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPWriteOptions

from cm.recording.layout import METADATA, Opened


class Channels:
    """Channels by topic and schema, the same in all files of a record."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        self._known: dict[tuple[str, str], foxglove.Channel] = {}

    def of(self, topic: str, schema: foxglove.Schema, encoding: str = "protobuf", **metadata: str) -> foxglove.Channel:
        """The channel of a topic, made when it is first asked for."""
        known = self._known.get((topic, schema.name))
        if known is None:
            known = foxglove.Channel(
                topic, message_encoding=encoding, schema=schema, context=self.context, metadata=metadata
            )
            self._known[topic, schema.name] = known
        return known


class _Sink:
    """A file that the library writes; from the first error on it swallows what comes."""

    def __init__(self, path: Path) -> None:
        """Raises OSError, also if there is such a file."""
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self.written = 0
        self.problem: OSError | None = None
        self._told = 0  # what the library believes

    def write(self, data: bytes | bytearray) -> int:
        self._told += len(data)
        rest = memoryview(data)
        while rest and self.problem is None:
            try:
                rest = rest[os.write(self._fd, rest) :]
            except OSError as error:
                self.problem = error
        self.written += len(data) - len(rest)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """The library asks where it is, and for nothing else."""
        if (offset, whence) not in ((0, os.SEEK_CUR), (self._told, os.SEEK_SET)):
            raise OSError(f"a record is written from the front to the end, not at {offset}")
        return self._told

    def flush(self) -> None:
        """Nothing waits here."""

    def sync(self) -> None:
        """Wait until the disk has it."""
        if self.problem is None:
            try:
                os.fdatasync(self._fd)
            except OSError as error:
                self.problem = error

    def close(self) -> None:
        os.close(self._fd)


class RecordFile:
    """A file that grows. One thread at a time; `sync` beside it."""

    def __init__(self, path: Path, channels: Channels, opened: Opened, profile: str = "") -> None:
        """Raises OSError."""
        self.path, self.opened = path, opened
        self.waiting = self.waiting_bytes = 0  # messages that are in no chunk on disk yet
        self.waiting_since = 0  # time of the first of them
        self._sink = _Sink(path)
        options = MCAPWriteOptions(compression=None, profile=profile, disable_seeking=True)
        self._writer = foxglove.open_mcap(self._sink, context=channels.context, writer_options=options)
        self._writer.write_metadata(METADATA, opened.strings())

    @property
    def length(self) -> int:
        """Bytes in the file."""
        return self._sink.written

    @property
    def problem(self) -> OSError | None:
        """Why the disk takes no more."""
        return self._sink.problem

    def log(self, channel: foxglove.Channel, data: bytes, time_ns: int) -> None:
        """A message; look at `problem` then."""
        before = self._sink.written
        if not self.waiting:
            self.waiting_since = time_ns
        self.waiting += 1
        self.waiting_bytes += len(data)
        channel.log(data, log_time=time_ns)
        if self._sink.written != before:
            self._settled()

    def flush(self) -> None:
        """Write what waits; look at `problem` then."""
        if self.waiting:
            self._writer.flush()
            self._settled()

    def _settled(self) -> None:
        if self._sink.problem is None:
            self.waiting = self.waiting_bytes = 0

    def sync(self) -> None:
        """Wait until the disk has what was written, so that it outlives a loss of power too. Beside all else."""
        self._sink.sync()

    def close(self) -> None:
        """End it, with its summary; look at `problem` then."""
        self._writer.close()
        self._settled()
        self._sink.close()

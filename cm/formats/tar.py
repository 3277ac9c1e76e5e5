# SPDX-License-Identifier: Apache-2.0
"""Tar archives from somebody who is not trusted, read as a stream: each step costs what the bytes before it allow.

`tarfile` takes what a header says: a long name of 3 GiB into memory, a list of pax records that it searches again and
again. Here names, headers, members, expanded bytes and processor time have limits, and only what is needed is
understood: files and folders (ustar, GNU and pax long names); plain, or compressed by gzip, bzip2 or xz. Other kinds of
members (links, devices, sparse files) are shown as what they are, for the caller to refuse.

Formats: POSIX.1-2017, pax, "ustar Interchange Format" and "pax Header Block"; GNU tar's manual, "Basic Tar Format".
"""

from __future__ import annotations

import bz2
import time
import zlib
from collections.abc import Iterator
from typing import BinaryIO, Protocol

from cm.frozen import dataclass

try:
    from lzma import FORMAT_XZ, LZMADecompressor, LZMAError
except ImportError:  # a Python without it cannot open such archives
    LZMADecompressor = None  # type: ignore[misc,assignment]
    LZMAError = zlib.error  # type: ignore[misc,assignment]

BLOCK = 512
_CHUNK = 1 << 16
_XZ_MEMORY = 128 << 20
_MAX_EXTENSION = 1 << 16  # bytes of a long name or of pax records: names of 255 bytes need some 300
_FILE, _FOLDER, _LONG_NAME, _LONG_LINK, _PAX, _PAX_ALL = b"0", b"5", b"L", b"K", b"x", b"g"


class BadTar(ValueError):
    """Not a whole tar archive, or one beyond the limits; the sentence says which."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Of an archive: bytes of all members together, members, bytes of a name, seconds of processor time."""

    total: int
    members: int
    name: int = 512
    seconds: float = 600.0


@dataclass(frozen=True, slots=True)
class Member:
    """A member; `kind`: its type flag, as ``0`` for a file and ``5`` for a folder."""

    name: str
    kind: bytes
    size: int
    mtime: int

    @property
    def is_file(self) -> bool:
        """A plain file."""
        return self.kind in (_FILE, b"\0", b"7")

    @property
    def is_folder(self) -> bool:
        """A folder."""
        return self.kind == _FOLDER


class TarStream:
    """Iterate over the members; `blocks` gives the content of the one that came last. Raises `BadTar`."""

    def __init__(self, file: BinaryIO, limits: Limits) -> None:
        self._limits = limits
        self._stream = _Stream(file, limits)
        self._left = 0  # bytes of the present member, with what fills its last block
        self._padding = 0

    def __iter__(self) -> Iterator[Member]:
        members, total, headers = 0, 0, 0
        name, size = "", None
        while (header := self._header()) is not None:
            headers += 1
            kind, stated = header[156:157], _number(header[124:136])
            if headers > 4 * self._limits.members:
                raise BadTar(f"more than {self._limits.members} members")
            if kind in (_LONG_NAME, _LONG_LINK, _PAX, _PAX_ALL):
                data = self._extension(stated)
                if kind == _LONG_NAME:
                    name = _text(data)
                elif kind == _PAX:
                    name, size = _records(data, name, size)
                continue
            found = Member(self._checked(name or _name(header)), kind, stated if size is None else size, _time(header))
            name, size = "", None
            members, total = members + 1, total + found.size
            if members > self._limits.members:
                raise BadTar(f"more than {self._limits.members} members")
            if total > self._limits.total:
                raise BadTar(f"more than {self._limits.total >> 20} MiB unpacked")
            # what is neither file nor unknown has no content, whatever its header says
            self._left = 0 if kind in b"123456" and kind else found.size
            self._padding = -self._left % BLOCK
            yield found
            for _ in self.blocks():
                pass
            self._stream.exactly(self._padding)
        self._stream.finish()

    def blocks(self) -> Iterator[bytes]:
        """The content of the present member, in pieces."""
        while self._left:
            piece = self._stream.exactly(min(self._left, _CHUNK))
            self._left -= len(piece)
            yield piece

    def _header(self) -> bytes | None:
        """The next header; None at the end, which is a block of zeros or the end of the file."""
        header = self._stream.upto(BLOCK)
        if not header or header == bytes(BLOCK):
            return None
        if len(header) < BLOCK:
            raise BadTar("it ends in the middle of a header")
        total = sum(header[:148]) + 8 * 32 + sum(header[156:])
        if total != _number(header[148:156]):
            raise BadTar("a header's checksum is wrong")
        return header

    def _extension(self, size: int) -> bytes:
        if size > _MAX_EXTENSION:
            raise BadTar(f"a long name or extended header of {size} bytes, where {_MAX_EXTENSION} is the most")
        data = self._stream.exactly(size)
        self._stream.exactly(-size % BLOCK)
        return data

    def _checked(self, name: str) -> str:
        if len(name.encode(errors="surrogateescape")) > self._limits.name:
            raise BadTar(f"a name of more than {self._limits.name} bytes: {name[:40]!r}…")
        return name


def _text(data: bytes) -> str:
    return data.split(b"\0", 1)[0].decode(errors="surrogateescape")


def _name(header: bytes) -> str:
    prefix = _text(header[345:500]) if header[257:263] == b"ustar\0" else ""
    return f"{prefix}/{_text(header[:100])}" if prefix else _text(header[:100])


def _number(field: bytes) -> int:
    """Octal digits, or GNU's binary form for what needs more."""
    if field[0] == 0x80:
        return int.from_bytes(field[1:], "big")
    text = field.strip(b" \0")
    if not text:
        return 0
    if not all(0x30 <= digit < 0x38 for digit in text):
        raise BadTar("a header has no octal number where one is expected")
    return int(text, 8)


def _time(header: bytes) -> int:
    try:
        return min(_number(header[136:148]), 1 << 40)
    except BadTar:
        return 0


def _records(data: bytes, name: str, size: int | None) -> tuple[str, int | None]:
    """``<length> <key>=<value>\\n``, of which path and size count."""
    while data and data.strip(b"\0"):
        length, blank, _ = data[:12].partition(b" ")
        if not blank or not length.isdigit() or not len(length) + 2 < int(length) <= len(data):
            raise BadTar("a pax record of another length than it says")
        key, _, value = data[len(length) + 1 : int(length) - 1].partition(b"=")
        if key == b"path":
            name = _text(value)
        elif key == b"size":
            if not value.isdigit() or len(value) > 18:
                raise BadTar("a pax record with a size that is no number")
            size = int(value)
        elif key.startswith(b"GNU.sparse"):
            raise BadTar("a sparse file")
        data = data[int(length) :]
    return name, size


class _Decompressor(Protocol):
    """What bz2 and lzma have."""

    @property
    def eof(self) -> bool: ...

    @property
    def needs_input(self) -> bool: ...

    @property
    def unused_data(self) -> bytes: ...

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        """At most `max_length` bytes more."""


class _Gzip:
    """gzip with the methods of bz2's decompressor."""

    def __init__(self) -> None:
        self._inner = zlib.decompressobj(31)
        self._waiting = b""

    @property
    def eof(self) -> bool:
        return self._inner.eof

    @property
    def needs_input(self) -> bool:
        return not self._waiting

    @property
    def unused_data(self) -> bytes:
        return self._inner.unused_data

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        made = self._inner.decompress(self._waiting + data, max_length)
        self._waiting = self._inner.unconsumed_tail
        return made


def _decompressor(start: bytes) -> _Decompressor | None:
    """The one for bytes that begin so; None for an archive that is not compressed."""
    if start.startswith(b"\x1f\x8b"):
        return _Gzip()
    if start.startswith(b"BZh"):
        return bz2.BZ2Decompressor()
    if start.startswith(b"\xfd7zXZ\0") and LZMADecompressor is not None:
        return LZMADecompressor(FORMAT_XZ, memlimit=_XZ_MEMORY)
    return None


class _Stream:
    """The expanded bytes of a file, made as they are asked for."""

    def __init__(self, file: BinaryIO, limits: Limits) -> None:
        self._file = file
        self._most = limits.total + (limits.members + 1) * (4 * BLOCK + _MAX_EXTENSION) + (16 << 20)
        self._until, self._seconds = time.thread_time() + limits.seconds, limits.seconds
        self._raw = file.read(_CHUNK)
        self._inner = _decompressor(self._raw)
        self._made = b""
        self._given = 0

    def upto(self, size: int) -> bytes:
        """The next `size` bytes, or fewer at the end."""
        parts = []
        while size:
            if not self._made and not self._fill():
                break
            part, self._made = self._made[:size], self._made[size:]
            parts.append(part)
            size -= len(part)
        return b"".join(parts)

    def exactly(self, size: int) -> bytes:
        """The next `size` bytes; `BadTar` if it ends before."""
        found = self.upto(size)
        if len(found) < size:
            raise BadTar("it ends in the middle of a member")
        return found

    def finish(self) -> None:
        """Read on to the end, where a compression has its checksum; zeros alone may follow, some MiB of them."""
        for _ in range((16 << 20) // _CHUNK + 1):
            if not self._made and not self._fill():
                return
            if self._made.strip(b"\0"):
                raise BadTar("something follows the last member")
            self._made = b""
        raise BadTar("more than 16 MiB behind the last file")

    def _fill(self) -> bool:
        """Make some more bytes; False at the end."""
        if time.thread_time() > self._until:
            raise BadTar(f"it takes more than {self._seconds:g} s of processor time to read")
        try:
            self._made = self._next()
        except (zlib.error, LZMAError, OSError, EOFError, ValueError) as problem:
            if isinstance(problem, OSError) and problem.errno is not None:
                raise
            raise BadTar(f"its compression is damaged: {problem}") from problem
        self._given += len(self._made)
        if self._given > self._most:
            raise BadTar(f"more than {self._most >> 20} MiB unpacked")
        return bool(self._made)

    def _next(self) -> bytes:
        while True:
            if self._inner is None:
                made, self._raw = self._raw, b""
                return made or self._file.read(_CHUNK)
            if self._inner.eof:
                rest = self._inner.unused_data or self._raw or self._file.read(_CHUNK)
                if not rest.strip(b"\0"):
                    return b""
                self._inner, self._raw = _decompressor(rest), rest
                if self._inner is None:
                    raise BadTar("something follows the compressed archive")
            if self._inner.needs_input and not self._raw:
                self._raw = self._file.read(_CHUNK)
                if not self._raw:
                    raise BadTar("its compression ends too early")
            data, self._raw = (self._raw, b"") if self._inner.needs_input else (b"", self._raw)
            made = self._inner.decompress(data, _CHUNK)
            if made:
                return made

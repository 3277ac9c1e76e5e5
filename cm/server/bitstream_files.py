# SPDX-License-Identifier: Apache-2.0
"""Bitstreams on disk: read, validated once per content, and copied for the kernel.

The kernel opens bitstreams itself, by name, after they were checked here. So we search where the kernel does
(drivers/base/firmware_loader/main.c: `fw_path`), and give it only our own copies, each named by the hash of what was
validated, and compared before and after.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Callable, Iterator
from pathlib import Path, PurePosixPath

from cm.errors import InvalidRequest
from cm.formats.bitstream import (
    Container,
    Expectation,
    Report,
    ReportCache,
    convert,
    to_dma_words,
    verify,
)
from cm.formats.bitstream.cache import Inspected
from cm.formats.bitstream.errors import BadContainer, BitstreamError, Sha256Mismatch
from cm.manager.interfaces import Image
from cm.server.folders import own_folder

MAX_BYTES = 512 << 20  # more than the largest device of the supported families needs

_KEPT = 256  # files

_Pair = tuple[str, str]
_SYNC = b"\x66\x55\x99\xaa"
_PADDING = (b"\x00\x00\x00\x20", bytes(4), b"\xff\xff\xff\xff")  # NOP; what fills up a file; dummy words


def image_of(path: Path, report: Report) -> Image:
    """A validated bitstream as the manager has it."""
    return Image(path, report.sha256, report.length, report.idcode, report.partial, report.encrypted)


class BitstreamReader:
    """Used by the worker and by plans that are made beside it, so the cache has a lock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache = ReportCache()
        self._good: dict[Path, tuple[Report, Expectation]] = {}  # files that were as expected when last compared
        self._same: set[_Pair] = set()  # file and image with the same words, by their hashes
        self._alike: set[_Pair] = set()  # file and image that differ in padding at most

    def validated(self, path: Path, expect: Expectation) -> Report:
        """The report of a file that is as expected. Raises the refusals of `cm.formats.bitstream`."""
        report, before = self.inspect(path), self._good.get(path)
        if before is not None and before[0] is report and before[1] == expect:
            return report
        try:
            verify(report, expect)
        except BitstreamError as error:
            raise type(error)(f"{path}: {error}") from error
        if len(self._good) >= _KEPT:
            self._good.clear()
        self._good[path] = report, expect
        return report

    def inspect(self, path: Path) -> Report:
        """The report of a file, from the cache if it is still the same file."""
        with self._lock:
            known = self._cache.known(path)
        if known is not None:
            return known
        _check_size(path)
        with self._lock:
            return self._cache.inspect(path)

    def read(self, image: Image) -> bytes:
        """The bytes that were validated. Raises Sha256Mismatch if the file has changed."""
        found = self._read(image.path)
        if found.report.sha256 != image.sha256:
            raise Sha256Mismatch(f"{image.path}: the file was replaced after it had been checked; ask again")
        return found.data

    def has_words_of(self, path: Path, image: Image) -> bool:
        """Whether a file, in whatever container, holds the words that were validated.

        Raises OSError, and the refusals of `cm.formats.bitstream` if it is not a bitstream.
        """
        return self._compared(path, image, self._same, bytes)

    def configures_as(self, path: Path, image: Image) -> bool:
        """Whether a file, in whatever container, configures the device as the image does.

        Vivado's .bin has one NOP more than its .bit, bootgen's has other padding. Raises as `has_words_of`.
        """
        return self._compared(path, image, self._alike, _effective)

    def _compared(self, path: Path, image: Image, known: set[_Pair], part: Callable[[bytes], bytes]) -> bool:
        there = self.inspect(path).sha256
        if there == image.sha256 or (there, image.sha256) in known:
            return True
        if path == image.path:
            return False
        found = self._read(path)  # once: a second look may find another file
        if part(to_dma_words(found.data)) != part(to_dma_words(self.read(image))):
            return False
        known.add((found.report.sha256, image.sha256))
        return True

    def _read(self, path: Path) -> Inspected:
        _check_size(path)
        with self._lock:
            return self._cache.read(path)


def _effective(words: bytes) -> bytes:
    """A stream in memory order from its sync word on, without the padding behind it."""
    start, end = max(0, words.find(_SYNC)), len(words)
    while end - start >= 4 and words[end - 4 : end] in _PADDING:
        end -= 4
    return words[start:end]


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise BadContainer(f"{path}: {size} bytes are not a bitstream; at most {MAX_BYTES >> 20} MiB are read")


_FIRMWARE = Path("lib/firmware")
_CUSTOM = Path("sys/module/firmware_class/parameters/path")
_CONVERTED = "cm-converted"
_OURS = re.compile(r"[0-9a-f]{64}\.bin")
_COPIES = 64


class FirmwareFolder:
    """The firmware below a root. `copies` is the folder for converted files, one that the kernel looks in.

    By default it is the folder that the kernel was given (firmware_class.path), which a system with a read-only root
    has on a tmpfs or a data partition, or else ``/lib/firmware``.
    """

    def __init__(self, root: Path, reader: BitstreamReader, copies: Path | None = None) -> None:
        self._root = root
        self.folder = root / _FIRMWARE
        self._reader = reader
        self._copies = copies

    def place(self, name: str) -> Path:
        """The file that the kernel opens for a name. Raises InvalidRequest for one that leaves the folder."""
        parts = PurePosixPath(name)
        if not name or parts.is_absolute() or ".." in parts.parts:
            raise InvalidRequest(f"firmware name {name!r}: a path below /lib/firmware is expected")
        places = [folder / name for folder in self._searched()]
        return next((place for place in places if place.exists()), places[-1])

    def _searched(self) -> Iterator[Path]:
        custom = self._custom()
        if custom is not None:
            yield custom
        release = os.uname().release
        yield from (self.folder / "updates" / release, self.folder / "updates", self.folder / release)
        yield self.folder

    def private_name(self, image: Image) -> str:
        """The name of our own copy of an image, whether or not it is there yet."""
        return f"{_CONVERTED}/{image.sha256}.bin"

    def _custom(self) -> Path | None:
        """The folder that the kernel searches first, if it was given one."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            custom = (self._root / _CUSTOM).read_text(encoding="utf-8").strip()
            if custom:
                return self._root / custom.lstrip("/")
        return None

    def _writable(self) -> Path:
        """The folder for copies. Raises InvalidRequest for one that the kernel does not search."""
        if self._copies is None:
            custom = self._custom()
            return custom if custom is not None and os.access(custom, os.W_OK) else self.folder
        if self._copies not in self._searched():
            raise InvalidRequest(
                f"firmware_dir {self._copies}: this kernel does not look there; tell it by firmware_class.path="
                f"{self._copies} on its command line, or in /{_CUSTOM}"
            )
        return self._copies

    def name_of(self, image: Image) -> str:
        """A name under which the kernel finds the image as a word-swapped .bin: always our own copy of it.

        Others may write to the file that was validated, between the check and the kernel's reading it.
        Raises Sha256Mismatch if that file changed since and the copy has to be made yet.
        """
        self._copy(image)
        name = self.private_name(image)
        self.check(name, image)
        return name

    def check(self, name: str, image: Image) -> None:
        """Raise Sha256Mismatch if the kernel would find other words under the name than were validated."""
        place = self.place(name)
        try:
            same = self._reader.has_words_of(place, image)
        except BitstreamError as error:
            raise Sha256Mismatch(f"{place}: {error}; the kernel would load it for {image.path}") from error
        if not same:
            raise Sha256Mismatch(f"{place}: not the bitstream that was checked as {image.path}; ask again")

    def _copy(self, image: Image) -> None:
        """Make sure of a copy under the hash of what was validated; a damaged one is made again."""
        base = self._writable()
        folder = base / _CONVERTED
        if folder.is_symlink():
            raise InvalidRequest(f"{folder} is a symbolic link; copies are not written through one")
        own_folder(folder, mode=0o755)  # the kernel reads from there, so no other user may write
        target = base / self.private_name(image)
        if not self._is_good(target, image):
            _write(target, convert(self._reader.read(image), Container.BIN_SWAPPED))
        _prune(folder, target)

    def _is_good(self, target: Path, image: Image) -> bool:
        try:
            return not target.is_symlink() and self._reader.has_words_of(target, image)
        except (BitstreamError, FileNotFoundError):
            return False


def _write(target: Path, data: bytes) -> None:
    """Write whole or not at all, even at a loss of power; never through a link."""
    import tempfile  # 1 MiB, not needed without the kernel's firmware loader

    descriptor, name = tempfile.mkstemp(dir=target.parent, prefix=".", suffix=".new")
    new = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(descriptor, 0o644)
            os.fsync(descriptor)
        new.replace(target)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _prune(folder: Path, used: Path) -> None:
    """Keep the most recently used copies: others are made again when needed.

    File times are only compared with each other, since a board without a clock begins in 1970.
    """
    others = [path for path in folder.iterdir() if _OURS.fullmatch(path.name) and path != used]
    ages = {path: path.lstat().st_mtime_ns for path in others}
    newest = max(ages.values(), default=0) + 1
    if used.stat().st_mtime_ns < newest:
        os.utime(used, ns=(newest, newest))
    for old in sorted(others, key=ages.__getitem__, reverse=True)[_COPIES - 1 :]:
        old.unlink(missing_ok=True)
    for half in folder.glob(".*.new"):  # of a run that was killed
        half.unlink(missing_ok=True)

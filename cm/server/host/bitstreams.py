# SPDX-License-Identifier: Apache-2.0
"""Bitstream files: read, validated once per content, and compared with what was validated before."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from cm.formats.bitstream import Expectation, Report, ReportCache, to_dma_words, verify
from cm.formats.bitstream.cache import Inspected
from cm.formats.bitstream.errors import BadContainer, BitstreamError, Sha256Mismatch
from cm.manager.interfaces import Image

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

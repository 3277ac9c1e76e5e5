# SPDX-License-Identifier: Apache-2.0
"""Bitstream files: read, validated once per content, and compared with what was validated before."""

from __future__ import annotations

import threading
from pathlib import Path

from cm.bitstream import Expectation, Report, ReportCache, to_dma_words, verify
from cm.bitstream.errors import BadContainer, BitstreamError, Sha256Mismatch
from cm.manager.ports import Image

MAX_BYTES = 512 << 20  # more than the largest device of the families that are read takes


class BitstreamReader:
    """Used by the worker and by plans that are made beside it, so the cache has a lock."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache = ReportCache()
        self._same: set[tuple[str, str]] = set()  # file and image with the same words, by their hashes

    def validated(self, path: Path, expect: Expectation) -> Image:
        """The image in a file. Raises the refusals of `cm.bitstream`."""
        report = self.inspect(path)
        try:
            verify(report, expect)
        except BitstreamError as error:
            raise type(error)(f"{path}: {error}") from error
        return Image(path, report.sha256, report.length, report)

    def inspect(self, path: Path) -> Report:
        """What is in a file, from the cache where it is the same file still."""
        _check_size(path)
        with self._lock:
            return self._cache.inspect(path)

    def read(self, image: Image) -> bytes:
        """The bytes that were validated. Raises Sha256Mismatch if the file has other ones by now."""
        _check_size(image.path)
        with self._lock:
            found = self._cache.read(image.path)
        if found.report.sha256 != image.sha256:
            raise Sha256Mismatch(f"{image.path}: the file was replaced after it had been checked; ask again")
        return found.data

    def has_words_of(self, path: Path, image: Image) -> bool:
        """Whether a file, in whatever container, holds the words that were validated.

        Raises OSError, and the refusals of `cm.bitstream` where it is no bitstream.
        """
        there = self.inspect(path).sha256
        pair = (there, image.sha256)
        if there == image.sha256 or pair in self._same:
            return True
        if path == image.path or to_dma_words(path) != to_dma_words(self.read(image)):
            return False
        self._same.add(pair)
        return True


def _check_size(path: Path) -> None:
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise BadContainer(f"{path}: {size} bytes are no bitstream; at most {MAX_BYTES >> 20} MiB are read")

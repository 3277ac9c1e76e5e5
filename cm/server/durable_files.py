# SPDX-License-Identifier: Apache-2.0
"""Files that outlive a loss of power; what fails on the way names its path, which a descriptor alone does not."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Give an OSError of a descriptor the path that it was about."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)
        raise


def write(path: Path, data: bytes | memoryview, mode: int = 0o600) -> None:
    """Write a file to the disk, not only to its cache: a rename that follows must not overtake the content.

    Nobody else may read it, unless `mode` says so. Raises OSError.
    """
    with naming(path), open(path, "wb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
        os.fchmod(file.fileno(), mode)
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def sync(folder: Path) -> None:
    """The same for the names in a folder. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with naming(folder):
            os.fsync(descriptor)
    finally:
        os.close(descriptor)

# SPDX-License-Identifier: Apache-2.0
"""An XSA or HDF, the ZIP archive that Vivado exports a design as → the .hwh and .bit files in it."""

from __future__ import annotations

import lzma
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from cm.design.errors import BuildError

ARCHIVES = (".xsa", ".hdf", ".zip")
MAX_MEMBER = 64 << 20  # bytes of one file in an archive
# one for each kind of damage; RuntimeError: a password is needed
_DAMAGED = (zipfile.BadZipFile, OSError, EOFError, ValueError, zlib.error, lzma.LZMAError, RuntimeError, IndexError)
MAX_ARCHIVE = 512 << 20  # bytes of all files read from an archive


def unpack(path: Path, folder: Path) -> list[Path]:
    """The .hwh and .bit files of an archive, written to `folder`."""
    try:
        with zipfile.ZipFile(path) as archive:
            return list(_members(archive, path, folder))
    except _DAMAGED as error:
        raise BuildError(f"{path}: not an XSA or HDF: {error}") from None


def _members(archive: zipfile.ZipFile, path: Path, folder: Path) -> Iterator[Path]:
    names: dict[str, str] = {}
    left = MAX_ARCHIVE
    for info in sorted(archive.infolist(), key=lambda info: info.filename):
        if info.is_dir() or Path(info.filename).suffix.lower() not in (".hwh", ".bit"):
            continue
        left -= info.file_size
        if info.file_size > MAX_MEMBER or left < 0:
            limit = f"{MAX_MEMBER >> 20} MiB a file, {MAX_ARCHIVE >> 20} MiB together"
            raise BuildError(f"{path}: {info.filename} has {info.file_size} bytes: more than an XSA holds ({limit})")
        name = Path(info.filename).name  # never a path out of the archive
        if name in names:
            raise BuildError(f"{path}: {names[name]} and {info.filename} have one name: unpack it and give one of them")
        names[name] = info.filename
        target = folder / name
        # no more than the directory states: zipfile stops there, and the checksum shows what is missing
        target.write_bytes(archive.read(info))
        yield target

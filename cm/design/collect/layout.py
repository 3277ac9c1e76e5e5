# SPDX-License-Identifier: Apache-2.0
"""The target folder ``<config>/`` (as it goes to /lib/firmware/cm/) and an archive of it, the same bytes each time."""

from __future__ import annotations

import gzip
import io
import tarfile
from collections.abc import Mapping
from pathlib import Path

from cm.design.errors import BuildError


def write_folder(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write `files` into `folder`; names that would lead out of it are refused, and its other files stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        if Path(name).name != name:
            raise BuildError(f"{name!r} is not a plain file name")
        part = folder / f".{name}.part"
        part.write_bytes(data)
        part.replace(folder / name)


def archive(name: str, files: Mapping[str, bytes]) -> bytes:
    """A .tar.gz with ``<name>/…``: sorted, without times and owners."""
    plain = io.BytesIO()
    with tarfile.open(fileobj=plain, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for path, data in sorted(files.items()):
            info = tarfile.TarInfo(f"{name}/{path}")
            info.size = len(data)
            info.mode = 0o644
            tar.addfile(info, io.BytesIO(data))
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb", mtime=0, filename="") as stream:
        stream.write(plain.getvalue())
    return packed.getvalue()

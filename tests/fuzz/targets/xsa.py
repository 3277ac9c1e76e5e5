# SPDX-License-Identifier: Apache-2.0
"""Vivado's .xsa and .hdf: unpacked, or BuildError; nothing is written outside the folder."""

from __future__ import annotations

import io
import shutil
import tempfile
import zipfile
from pathlib import Path

from cm.design.collect.xsa import unpack
from cm.design.errors import BuildError

PACKAGES = ("cm.design.collect", "zipfile")
MAX_LENGTH = 16384
_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")


def seeds() -> list[bytes]:
    return [
        _zip({"design.hwh": b"<EDKSYSTEM/>", "design.bit": b"bits", "sysdef.xml": b"<x/>"}, zipfile.ZIP_DEFLATED),
        _zip({"a/design.hwh": b"<EDKSYSTEM/>", "../up.bit": b"bits"}, zipfile.ZIP_STORED),
    ]


def _zip(files: dict[str, bytes], method: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name), data, method)
    return out.getvalue()


def one(data: bytes) -> None:
    archive, out = Path(_FOLDER.name, "design.xsa"), Path(_FOLDER.name, "out")
    archive.write_bytes(data)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    try:
        found = unpack(archive, out)
    except BuildError as error:
        str(error)
        return
    assert all(path.parent == out and path.is_file() for path in found)
    assert {path.name for path in Path(_FOLDER.name).iterdir()} == {"design.xsa", "out"}

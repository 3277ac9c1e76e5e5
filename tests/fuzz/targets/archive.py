# SPDX-License-Identifier: Apache-2.0
"""Archives of `cm build collect`: unpacked whole, or refused with nothing left behind."""

from __future__ import annotations

import gzip
import io
import shutil
import tarfile
import tempfile
from pathlib import Path

from cm.formats.importers.archive import unpack
from cm.formats.importers.result import ImportRefused
from cm.schema import SchemaError
from cm.schema.files import FileMissing

PACKAGES = ("cm.formats.importers", "tarfile")
MAX_LENGTH = 16384

_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")
_SCHEMA = b"config:\n  name: c\n  modules: {a: {bitstream: a.bit}}\n  modes: {m: {modules: [a]}}\n"


def seeds() -> list[bytes]:
    whole = _tar({"c": None, "c/c.yaml": _SCHEMA, "c/a.bit": b"bits"})
    return [whole, gzip.compress(whole, mtime=0), _tar({"c/c.yaml": _SCHEMA}), _tar({"../c.yaml": _SCHEMA})]


def _tar(files: dict[str, bytes | None]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name, data in files.items():
            info = tarfile.TarInfo(name)
            info.type, info.size = (tarfile.DIRTYPE, 0) if data is None else (tarfile.REGTYPE, len(data))
            tar.addfile(info, None if data is None else io.BytesIO(data))
    return out.getvalue()


def one(data: bytes) -> None:
    archive, out = Path(_FOLDER.name, "archive.tar"), Path(_FOLDER.name, "out")
    archive.write_bytes(data)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    try:
        found = unpack(archive, out)
    except (ImportRefused, SchemaError, FileMissing) as error:
        str(error)
        left = {path.name for path in out.iterdir() if not path.name.endswith(".lock")}
        assert not left - {".lock"}, left
        return
    assert found.folder.parent == out.resolve()
    assert sorted(path.name for path in found.folder.iterdir()) == list(found.files)

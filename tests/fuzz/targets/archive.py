# SPDX-License-Identifier: Apache-2.0
"""Archives of `cm build collect`: unpacked whole, or refused with nothing left behind."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import shutil
import tarfile
import tempfile
from functools import partial
from pathlib import Path

from cm.formats.importers.archive import unpack
from cm.formats.importers.result import ImportRefused
from cm.schema import SchemaError
from cm.schema.named_files import FileMissing

PACKAGES = ("cm.formats.importers", "cm.formats.tar")
MAX_LENGTH = 16384

_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")
_SCHEMA = b"config:\n  name: c\n  modules: {a: {bitstream: a.bit}}\n  modes: {m: {modules: [a]}}\n"


def seeds() -> list[bytes]:
    whole = _tar({"c": None, "c/c.yaml": _SCHEMA, "c/a.bit": b"bits"})
    others = [compress(whole) for compress in (partial(gzip.compress, mtime=0), bz2.compress, lzma.compress)]
    return [whole, *others, _tar({"c/c.yaml": _SCHEMA}), _tar({"../c.yaml": _SCHEMA}), *_bombs()]


def _bombs() -> list[bytes]:
    """Archives that want more than they hold: names, records, zeros, and members that are no files."""
    kinds = [_header(kind, 0) for kind in (b"1", b"2", b"3", b"4", b"6", b"S", b"M")]
    long = gzip.compress((_header(b"L", 1 << 20) + b"c/" + bytes(1 << 20))[: 3 << 18] * 4, mtime=0)
    records = _header(b"x", 500) + (b"1" * 500).ljust(512, b"\0")
    zeros = [compress(_header(b"0", 0) + bytes(20 << 20)) for compress in (gzip.compress, bz2.compress, lzma.compress)]
    return [*kinds, long, records, *zeros, _header(b"0", 1 << 40), _header(b"K", 1 << 40)]


def _header(kind: bytes, size: int) -> bytes:
    info = tarfile.TarInfo("c/x")
    info.type, info.size = kind, size
    return info.tobuf(tarfile.GNU_FORMAT)


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

# SPDX-License-Identifier: Apache-2.0
"""Runtime schemas: a configuration, or SchemaError; a configuration survives its normal form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cm.schema import SchemaError, dump, loads

PACKAGES = ("cm.schema",)
MAX_LENGTH = 8192
_ROOT = Path(__file__).resolve().parents[3]


def seeds() -> list[bytes]:
    files = [_ROOT / "cm" / "data" / "camera" / "camera.yaml", _ROOT / "tests" / "data" / "listing1.yaml"]
    small = b"config:\n  name: c\n  modules: {a: {}}\n  modes: {m: {modules: [a], registers: {r: 0x10}}}\n"
    return [small, *(file.read_bytes()[:MAX_LENGTH] for file in files)]


def one(data: bytes) -> None:
    try:
        config = loads(data.decode("utf-8", "surrogateescape"))
    except SchemaError as error:
        str(error)
        return
    again = loads(dump(config))
    assert replace(again, source=None, sha256_source="") == replace(config, source=None, sha256_source="")

# SPDX-License-Identifier: Apache-2.0
"""build.yaml: a project, or SchemaError."""

from __future__ import annotations

import tempfile
from pathlib import Path

from cm.design.project.load import load_project
from cm.schema import SchemaError

PACKAGES = ("cm.design.project", "cm.schema")
MAX_LENGTH = 8192
_EXAMPLES = Path(__file__).resolve().parents[3] / "cm" / "data" / "examples"
_FOLDER = tempfile.TemporaryDirectory(prefix="cm-fuzz-")


def seeds() -> list[bytes]:
    return [path.read_bytes() for path in sorted(_EXAMPLES.glob("*/build.yaml"))]


def one(data: bytes) -> None:
    path = Path(_FOLDER.name, "build.yaml")
    path.write_bytes(data)
    try:
        load_project(path)
    except SchemaError as error:
        str(error)

# SPDX-License-Identifier: Apache-2.0
"""Mistakes that show only once the HDL is read: told with the place in the build schema, as all others are."""

from __future__ import annotations

from pathlib import Path

from cm.build.errors import BuildError
from cm.schema.problems import KeyPath, Problem, key_path
from cm.schema.reader import Refused, read
from cm.schema.tree import Mark, locate


def fault(source: Path, key: KeyPath, message: str, hint: str = "") -> BuildError:
    """The error for a value of the build schema in `source`: file, line, column and key before the sentence.

    Of a key that is not written there the nearest above it is told.
    """
    mark = _mark(source, key)
    return BuildError(str(Problem(source, mark.line, mark.column, key_path(key), "build_failed", message, hint)))


def _mark(source: Path, key: KeyPath) -> Mark:
    try:
        return locate(read(source.read_text(encoding="utf-8"), lambda *_: None), key)
    except (OSError, UnicodeDecodeError, Refused):  # it was read before, so it has just gone or changed
        return Mark(0, 0)

# SPDX-License-Identifier: Apache-2.0
"""Mistakes that show only after the HDL is read, reported with their place in the build schema like all others.

What a check has found: a sentence, its place in the build schema, and where the rule comes from.
"""

from __future__ import annotations

from pathlib import Path

from cm.design.errors import BuildError
from cm.frozen import dataclass
from cm.schema.problems import KeyPath, Problem, key_path
from cm.schema.reader import Refused, read
from cm.schema.tree import Mark, locate

OPEN_FLOW = "open flow"  # the rule of a finding about what the open tools cannot do


def fault(source: Path, key: KeyPath, message: str, hint: str = "") -> BuildError:
    """Make the error for a value of the build schema in `source`: file, line, column and key before the sentence.

    For a key that is not in the file, the nearest one above it is named.
    """
    mark = _mark(source, key)
    return BuildError(str(Problem(source, mark.line, mark.column, key_path(key), "build_failed", message, hint)))


def _mark(source: Path, key: KeyPath) -> Mark:
    try:
        return locate(read(source.read_text(encoding="utf-8"), lambda *_: None), key)
    except (OSError, UnicodeDecodeError, Refused):  # it was read before, so it has just been removed or changed
        return Mark(0, 0)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that Vivado would refuse (`error`) or that a designer should know.

    `rule` is the message's number in Vivado, or a name made up here if Vivado has none; `docs/build-vivado.md` has
    the sources.
    """

    rule: str
    key: KeyPath
    message: str
    hint: str = ""
    error: bool = True

    def text(self, source: Path) -> str:
        """With file, line, column and key."""
        return f"{fault(source, self.key, self.message, self.hint)} [{self.rule}]"

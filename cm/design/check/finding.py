# SPDX-License-Identifier: Apache-2.0
"""What a check has found: a sentence, its place in the build schema, and where the rule comes from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cm.design.project.where import fault
from cm.schema.problems import KeyPath


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

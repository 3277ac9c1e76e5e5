# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a schema file, and where: `Problem`, and `SchemaError` that carries them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import ClassVar

from cm.errors import CmError
from cm.frozen import dataclass

MAX_PROBLEMS = 100  # a file with that many is not a schema
KeyPath = tuple[str | int, ...]
_LONGEST_NAME = 64
_MOST_NAMES = 40  # that a hint lists


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong.

    `path` is the file (None for text without one), `line` and `column` count from 1 (0: unknown),
    `key` is like ``config.modes.edge.mmio[0].base_address``, `code` is stable, `message` says what
    is wrong and `hint` (may be empty) what would be right.
    """

    path: Path | None
    line: int
    column: int
    key: str
    code: str
    message: str
    hint: str = ""

    def __str__(self) -> str:
        """One line in the form that compilers use, which editors can jump to."""
        where = str(self.path or "<text>") + (f":{self.line}:{self.column}" if self.line else "")
        key = f" {self.key}:" if self.key else ""
        hint = f" ({self.hint})" if self.hint else ""
        return f"{where}:{key} {self.message}{hint}"


class SchemaError(CmError, ValueError):
    """A runtime schema that is not valid; `problems` holds at least one, in the order of the file."""

    code: ClassVar[str] = "schema_invalid"

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


def key_path(path: Iterable[str | int]) -> str:
    """``("config", "mmio", 0, "registers")`` as ``config.mmio[0].registers``."""
    text = ""
    for step in path:
        name = step if isinstance(step, int) else step[:_LONGEST_NAME]
        text += f"[{name}]" if isinstance(name, int) else f".{name}" if text else name
    return text


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The hint for an unknown name: the nearest one, or the list of all."""
    import difflib  # only files that are wrong need it

    names = list(known)
    near = [name for name in names if name.lower() == word.lower()]  # as far as others, for difflib
    near = near or difflib.get_close_matches(word[:_LONGEST_NAME], names, n=1, cutoff=0.6)
    if near:
        return f"did you mean {near[0]}?"
    if not names:
        return "there are none"
    return f"known: {', '.join(names[:_MOST_NAMES])}" + (", …" if len(names) > _MOST_NAMES else "")

# SPDX-License-Identifier: Apache-2.0
"""JSON in which numbers may be strings, hexadecimal or empty, as dfx-mgr's files have them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cm.formats.importers.result import ImportRefused


@dataclass(frozen=True, slots=True)
class Fields:
    """A JSON object and the file it is from."""

    source: Path
    values: dict[str, Any]

    @classmethod
    def read(cls, path: Path) -> Fields:
        """Read a file. Raises `ImportRefused` for what is not a JSON object."""
        try:
            values = json.loads(path.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ImportRefused(f"{path}: not JSON: {error}") from error
        if not isinstance(values, dict):
            raise ImportRefused(f"{path}: a JSON object expected, found {type(values).__name__}")
        return cls(path, values)

    def text(self, key: str) -> str:
        """A value as text; empty if it is not there."""
        value = self.values.get(key)
        return str(value).strip() if isinstance(value, (str, int)) and not isinstance(value, bool) else ""

    def number(self, key: str, base: int = 0) -> int | None:
        """A number, or None for one that is not there or empty. Raises `ImportRefused` for other text."""
        return to_number(self.text(key), f"{self.source}: {key}", base)

    def items(self, key: str) -> list[Fields]:
        """The objects in a list."""
        found = self.values.get(key)
        return (
            [Fields(self.source, item) for item in found if isinstance(item, dict)] if isinstance(found, list) else []
        )

    def inner(self, key: str) -> Fields:
        """The object at a key; an empty one if it is not there."""
        found = self.values.get(key)
        return Fields(self.source, found if isinstance(found, dict) else {})

    def texts(self, key: str) -> list[str]:
        """The texts in a list."""
        found = self.values.get(key)
        return [str(item) for item in found] if isinstance(found, list) else []


def to_number(text: str, where: str, base: int = 0) -> int | None:
    """Read a number that may be empty; `base` 16 for those without 0x."""
    if not text:
        return None
    try:
        value = int(text, base)
    except ValueError:
        raise ImportRefused(f"{where}: {text!r} is not a number") from None
    if value < 0:
        raise ImportRefused(f"{where}: {text} is below 0")
    return value

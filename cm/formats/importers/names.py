# SPDX-License-Identifier: Apache-2.0
"""Names of other formats as names of the runtime schema."""

from __future__ import annotations

import re

_LONGEST = 64


def to_name(text: str) -> str:
    """Return `text` with what a name cannot have replaced by ``_``; ``unnamed`` if nothing is left."""
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_-")[:_LONGEST].rstrip("_-") or "unnamed"
    return name if not name[0].isdigit() else f"_{name}"[:_LONGEST]


class Names:
    """Gives each thing a unique name: the second `irq` becomes `irq_2`."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def take(self, text: str) -> str:
        """Return a name made from `text` that has not been used before."""
        name = base = to_name(text)
        count = 1
        while name in self._taken:
            count += 1
            suffix = f"_{count}"
            name = base[: _LONGEST - len(suffix)] + suffix
        self._taken.add(name)
        return name

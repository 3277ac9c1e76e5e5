# SPDX-License-Identifier: Apache-2.0
"""A range of addresses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """A range of addresses: `base` physical, `size` a power of two."""

    name: str
    base: int
    size: int
    doc: str = ""

    @property
    def end(self) -> int:
        """The first address after it."""
        return self.base + self.size

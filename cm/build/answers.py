# SPDX-License-Identifier: Apache-2.0
"""What only the user can say about a configuration; `cm build configure` asks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from cm.build.project import empty


@dataclass(frozen=True, slots=True)
class StreamAnswer:
    """A stream's frame; None: as in the build schema."""

    shape: tuple[int, ...] | None = None
    dtype: str | None = None
    slots: int | None = None


@dataclass(frozen=True, slots=True)
class Answers:
    """`registers` has defaults by (implementation, register); None and {}: as in the build schema."""

    default_mode: str | None = None
    static_overlay: bool = True
    streams: Mapping[str, StreamAnswer] = field(default_factory=empty)
    registers: Mapping[tuple[str, str], int] = field(default_factory=empty)

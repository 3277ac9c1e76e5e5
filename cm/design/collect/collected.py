# SPDX-License-Identifier: Apache-2.0
"""The inputs and the result of `cm build collect`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from cm.design.collect.handoff import Handoff
from cm.design.collect.images import Image
from cm.design.errors import BuildError
from cm.schema.model import Config


@dataclass(frozen=True, slots=True)
class Collected:
    """A configuration ready for the target: `files` lie flat in ``/lib/firmware/cm/<config>/``."""

    config: Config
    files: Mapping[str, bytes]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Inputs:
    """Descriptions and bitstreams that were given."""

    handoffs: tuple[Handoff, ...]
    images: tuple[Image, ...]

    @property
    def whole(self) -> Handoff | None:
        """The description of the whole design, if there is one; BuildError if there are several."""
        found = [entry for entry in self.handoffs if not entry.partial]
        if len(found) > 1:
            raise BuildError(f"several whole designs: {', '.join(entry.name for entry in found)}; give one at a time")
        return found[0] if found else None

# SPDX-License-Identifier: Apache-2.0
"""A region of the simulated board, as frozen data."""

from __future__ import annotations

from dataclasses import dataclass

from cm.schema.model import Decoupler, FrameRange, Identity


@dataclass(frozen=True, slots=True)
class RegionSpec:
    """A region of the board; its columns of frames are its own."""

    name: str
    footprint: tuple[FrameRange, ...]
    decoupler: Decoupler | None = None
    identity: Identity | None = None

# SPDX-License-Identifier: Apache-2.0
"""Which DMA channels a board has, and what is at their other end."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cm.schema.model import Config, Direction, Stream

if TYPE_CHECKING:
    import numpy as np
else:
    from cm.lazy_numpy import np


DEFAULT_RATE = 30.0


@dataclass(frozen=True, slots=True)
class ChannelSpec:
    """A DMA channel.

    A memory-to-stream channel feeds its region, and `partner` is the channel that takes the result
    (None: the data is consumed). A stream-to-memory one without a partner is a camera.
    """

    name: str
    direction: Direction
    region: str | None
    shape: tuple[int, ...] | None
    dtype: str
    rate: float
    partner: str | None = None
    vdma: bool = False  # moves lines only
    simple: int = 0  # bits of the length register of an engine without scatter/gather; 0: it has scatter/gather
    blind: bool = False  # its driver cannot tell how much arrived

    @property
    def frame_length(self) -> int:
        """Bytes of one frame, or 0 if the schema gives no shape."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize if self.shape else 0

    @property
    def is_camera(self) -> bool:
        """Whether frames come by themselves."""
        return self.direction is Direction.S2MM and self.partner is None


def channels_of(configs: Iterable[Config]) -> dict[str, ChannelSpec]:
    """The channels of all streams, each paired with the one at the other side of its region."""
    found: dict[str, ChannelSpec] = {}
    for config in configs:
        streams = list(config.streams.values())
        for mode in config.modes.values():
            streams.extend(mode.streams.values())
        for stream in streams:
            found.setdefault(stream.channel, _channel(stream))
    for region in {spec.region for spec in found.values()}:
        _pair(found, region)
    return found


def _channel(stream: Stream) -> ChannelSpec:
    rate = stream.rate or DEFAULT_RATE
    return ChannelSpec(stream.channel, stream.direction, stream.region, stream.shape, stream.dtype, rate)


def _pair(found: dict[str, ChannelSpec], region: str | None) -> None:
    """Pair in the order of the file; a channel called camera… is a camera as long as there are others."""
    here: Mapping[str, ChannelSpec] = {n: s for n, s in found.items() if s.region == region}
    sources = [n for n, s in here.items() if s.direction is Direction.MM2S]
    sinks = [n for n, s in here.items() if s.direction is Direction.S2MM]
    sinks.sort(key=lambda name: "camera" in name or "cam" in name.split("_"))
    for source, sink in zip(sources, sinks, strict=False):
        found[source] = replace(found[source], partner=sink)
        found[sink] = replace(found[sink], partner=source)

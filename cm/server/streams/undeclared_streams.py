# SPDX-License-Identifier: Apache-2.0
"""The streams of a configuration that declares none: the board's DMA channels under their own names."""

from __future__ import annotations

import logging
from types import MappingProxyType

from cm.device import AxiDma, Root, list_dma
from cm.device import Direction as ChannelDirection
from cm.errors import CmError
from cm.frozen import replace
from cm.schema.model import Config, Direction, Stream

_LOG = logging.getLogger(__name__)
_DIRECTIONS = {ChannelDirection.MM2S: Direction.MM2S, ChannelDirection.S2MM: Direction.S2MM}


def with_channels(config: Config, root: Root) -> Config:
    """Return `config`, or a copy with one stream per DMA channel if it declares no streams, as the paper's Listing 1.

    Such a stream has no shape: a frame is flat bytes, as many as arrived. If there is exactly one region, the
    stream counts as passing through it, so that it stops while the region is reconfigured. A channel whose name
    is that of a memory is left out: its data are read and written by name.
    """
    if config.streams or any(mode.streams for mode in config.modes.values()):
        return config
    region = next(iter(config.regions)) if len(config.regions) == 1 else None
    taken = {name for mode in config.modes for name in config.visible_memories(mode)}
    channels = {name: way for name, way in _channels(root).items() if name not in taken}
    streams = {name: Stream(name, name, way, region=region) for name, way in channels.items()}
    frozen = MappingProxyType(streams)
    modes = {name: replace(mode, streams=frozen) for name, mode in config.modes.items()}
    return replace(config, streams=frozen, modes=MappingProxyType(modes))


def _channels(root: Root) -> dict[str, Direction]:
    """The board's channels and their directions; without those that cannot be opened now."""
    found = {}
    for name in list_dma(root):
        try:
            with AxiDma.open(name, root) as channel:
                found[name] = _DIRECTIONS[channel.info.direction]
        except CmError as error:
            _LOG.warning("DMA channel %s is left out: %s", name, error)
    return found

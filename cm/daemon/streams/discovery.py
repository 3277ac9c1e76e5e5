# SPDX-License-Identifier: Apache-2.0
"""Streams of a configuration that names none: the board's DMA channels under their own names."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import MappingProxyType

from cm.device import AxiDma, Root, list_dma
from cm.device import Direction as ChannelDirection
from cm.errors import CmError
from cm.schema.model import Config, Direction, Stream

_LOG = logging.getLogger(__name__)
_DIRECTIONS = {ChannelDirection.MM2S: Direction.MM2S, ChannelDirection.S2MM: Direction.S2MM}


def with_channels(config: Config, root: Root) -> Config:
    """`config`, or, where it has no streams (the paper's Listing 1 has none), one with a stream for each channel.

    Such a stream has no shape: frames are flat bytes of the length that came. It counts as passing
    through the region if there is only one, so that it is stopped while that is reconfigured. A channel that
    is called as a memory is left out: data are read and written by name.
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
    """The board's channels that are free to be asked, and their directions."""
    found = {}
    for name in list_dma(root):
        try:
            with AxiDma.open(name, root) as channel:
                found[name] = _DIRECTIONS[channel.info.direction]
        except CmError as error:
            _LOG.warning("DMA channel %s is left out: %s", name, error)
    return found

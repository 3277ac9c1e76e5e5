# SPDX-License-Identifier: Apache-2.0
"""How much may wait for a slow subscriber.

ZeroMQ's high-water mark counts messages, of any length, for each subscriber. `mark()` makes one of a limit
in bytes (`cm serve --stream-queue`) and the longest frame that the schemas know. It is set before the socket
is bound and never again: while a subscriber is going, setting it makes libzmq, up to and with 4.3.5, use a
pipe that it has freed (mended by its pull request 4647, which is in no release yet).
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from cm.schema.model import ITEM_BYTES, Config, Stream

BYTES = 32 << 20  # of frames that wait for one subscriber, unless set otherwise
_FEWEST, _MOST = 2, 1000  # messages
_FLAT = 1 << 20  # bytes of a frame that no schema describes, or that may grow


def mark(configs: Iterable[Config], limit: int) -> int:
    """How many messages may wait for one subscriber: the longest frames of `configs` stay within `limit` bytes."""
    longest = max((_frame_bytes(stream) for config in configs for stream in _streams(config)), default=0)
    return max(_FEWEST, min(_MOST, limit // max(longest, _FLAT)))


def _streams(config: Config) -> Iterable[Stream]:
    yield from config.streams.values()
    for mode in config.modes.values():
        yield from mode.streams.values()


def _frame_bytes(stream: Stream) -> int:
    return math.prod(stream.shape) * ITEM_BYTES.get(stream.dtype, 16) if stream.shape else 0

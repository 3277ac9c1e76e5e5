# SPDX-License-Identifier: Apache-2.0
"""How much may wait for a slow subscriber.

ZeroMQ's high-water mark counts messages, of any length, for each subscriber. `mark()` makes one of a limit
in bytes (`cm serve --stream-queue`) and the longest frame that the schemas know. It is set before the socket is bound
and never again: setting it while a subscriber disconnects makes libzmq up to 4.3.5 use a pipe that it has freed
(fixed by its pull request 4647, which is in no release yet).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable

from cm.schema.model import ITEM_BYTES, Config, Stream
from cm.server.settings.model import StreamSettings
from cm.server.shares.clients import Tracker

BYTES = int(StreamSettings().queue_mib * (1 << 20))  # of frames that wait for one subscriber, unless set otherwise
_FEWEST, _MOST = 2, 1000  # messages
_ON_THEIR_WAY = 4  # messages that libzmq holds beside those that it counts
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


class Kept:
    """Frames that some subscriber has not received yet, with a bound on all together.

    Each subscriber may leave different ones unread. If all exceed one and a half times what one may leave unread
    (`limit` bytes, `mark` messages), the subscriber that has not read for longest is disconnected.
    """

    def __init__(self, limit: int, mark: int, end_slowest: Callable[[], object]) -> None:
        self._limit, self._mark = limit * 3 // 2, mark * 3 // 2 + _ON_THEIR_WAY
        self._end_slowest = end_slowest
        self._frames: deque[tuple[Tracker, int]] = deque()
        self.bytes = 0  # as of the last look

    def add(self, tracker: Tracker, size: int) -> None:
        """Note a frame that was sent to its subscribers."""
        self._frames.append((tracker, size))
        self.bytes += size
        most = max(self._limit, self._mark * size)
        if self._frames[0][0].done or self.bytes > most:
            self._look()
        if self.bytes > most:
            self._end_slowest()

    def _look(self) -> None:
        self._frames = deque([(tracker, size) for tracker, size in self._frames if not tracker.done])
        self.bytes = sum([size for _, size in self._frames])

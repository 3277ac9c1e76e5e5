# SPDX-License-Identifier: Apache-2.0
"""The log of who did what: the first record of a burst is written at once, the number of the others when it is over."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from cm.frozen import dataclass
from cm.server.rights.principal import Principal, printable
from cm.wire.messages import requests as rq

_LOG = logging.getLogger("cm.audit")
BURST = 10.0  # seconds
_MOST = 512  # bursts at once; all beyond that count as one
_NAMED = 4  # registers of one request that are named


@dataclass(slots=True)
class _Burst:
    text: str
    level: int
    until: float
    more: int = 0


class Audit:
    """One thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._bursts: dict[tuple[str, str], _Burst] = {}

    def note(self, connection: str, kind: str, say: Callable[[], str], level: int = logging.INFO) -> None:
        """Something of this kind happened over a connection; `say` is asked for its sentence only if it is logged."""
        burst = self._bursts.get((connection, kind))
        if burst is not None and self._clock() < burst.until:
            burst.more += 1
            return
        if burst is not None:
            self._end(burst)
        elif len(self._bursts) >= _MOST and (connection or kind):
            self.note("", "", lambda: "more is going on than is logged line by line", level)
            return
        text = say()
        _LOG.log(level, "%s", text)
        self._bursts[connection, kind] = _Burst(text, level, self._clock() + BURST)

    def flush(self) -> None:
        """Log the bursts that are over; called now and then."""
        now = self._clock()
        over = [key for key, burst in self._bursts.items() if burst.until <= now]
        for key in over:
            self._end(self._bursts.pop(key))

    def _end(self, burst: _Burst) -> None:
        if burst.more:
            _LOG.log(burst.level, "%s: %d more within %d s", burst.text, burst.more, int(BURST))


def described(who: Principal, request: rq.Request) -> str:
    """Who did what, in a line; data are only named, not shown."""
    return f"{who}: {type(request).__name__}{_subject(request)}"


def _subject(request: rq.Request) -> str:
    if isinstance(request, rq.WriteReg):
        names = [write.name for write in request.writes[:_NAMED]]
        rest = len(request.writes) - len(names)
        return f" {', '.join(map(printable, names))}{f' and {rest} more' if rest else ''}"
    if isinstance(request, rq.ChangeMode):
        said = request.unload and f"unload {request.unload}"
        return " " + printable(said or request.name_or_mode or f"{request.config_name}/{request.mode}".strip("/"))
    for name in ("config_name", "stream", "name", "scope", "id"):
        value = getattr(request, name, None)
        if value:
            return " " + printable(str(value))
    return ""

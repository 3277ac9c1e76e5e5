# SPDX-License-Identifier: Apache-2.0
"""How many requests may wait for changes of mode: a node whose threads all wait could not even be told to cancel."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from cm.errors import Busy


class Waiting:
    """`most` at a time, fewer than the middleware has threads."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._free = threading.BoundedSemaphore(most)

    @contextmanager
    def one(self) -> Iterator[None]:
        """Within it a request may take as long as a change does. Raises Busy where as many wait as may."""
        if not self._free.acquire(blocking=False):
            raise Busy(f"{self._most} requests wait for changes of mode at this node already: ask again later")
        try:
            yield
        finally:
            self._free.release()

# SPDX-License-Identifier: Apache-2.0
"""What pages are sent, by topic: only the newest message of each is kept, however slow a page is."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import Any

Listener = Callable[[str], None]


class Topics:
    """The present state, as JSON by topic."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}
        self._listeners: set[Listener] = set()

    def listen(self, listener: Listener) -> None:
        """Call with every topic that changes."""
        self._listeners.add(listener)

    def ignore(self, listener: Listener) -> None:
        """Call no more."""
        self._listeners.discard(listener)

    def tell(self, topic: str, value: Any) -> None:
        """A topic has a new value."""
        text = json.dumps(value)
        if self._texts.get(topic) == text:
            return
        self._texts[topic] = text
        for listener in tuple(self._listeners):
            listener(topic)

    def names(self) -> Iterable[str]:
        """All topics."""
        return tuple(self._texts)

    def message(self, topics: Iterable[str]) -> str:
        """One message with these topics, each once."""
        parts = [f"{json.dumps(topic)}:{self._texts[topic]}" for topic in topics if topic in self._texts]
        return f"{{{','.join(parts)}}}"

# SPDX-License-Identifier: Apache-2.0
"""What was set of streams beside what the schema says, and for how long."""

from __future__ import annotations

from collections.abc import Callable

from cm.messages.requests import ConfigureStream
from cm.schema.model import Stream


class StreamOverrides:
    """Settings last until the mode changes; what was enabled runs on until another configuration is loaded."""

    def __init__(self) -> None:
        self._set: dict[str, tuple[Stream, Stream]] = {}  # as the schema has it, and as it was set
        self._runs: dict[str, bool] = {}

    def take(self, stream: Stream, wanted: Stream, request: ConfigureStream) -> Callable[[], None]:
        """Note what a request changes of a stream as it is now; the result takes that back."""
        name, before = stream.name, (self._set.copy(), self._runs.copy())
        if wanted != stream:
            base = self._set[name][0] if name in self._set else stream
            self._set[name] = base, wanted
        if request.automatic:
            self._runs.pop(name, None)
        elif request.enable is not None:
            self._runs[name] = request.enable

        def take_back() -> None:
            self._set, self._runs = before

        return take_back

    def of(self, stream: Stream) -> Stream:
        """A stream of the schema as it was set."""
        base, wanted = self._set.get(stream.name, (None, stream))
        if base == stream:
            return wanted
        self._set.pop(stream.name, None)  # of a schema that was replaced
        return stream

    def runs(self, name: str) -> bool | None:
        """Whether a stream shall run whoever listens; None: nobody has said."""
        return self._runs.get(name)

    def mode_changed(self) -> None:
        """What a mode has is the schema's until somebody changes it again; what runs runs on."""
        self._set.clear()
        self._runs = {name: True for name, runs in self._runs.items() if runs}

    def config_changed(self) -> None:
        """Streams of the same name are others."""
        self._set.clear()
        self._runs.clear()

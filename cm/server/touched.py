# SPDX-License-Identifier: Apache-2.0
"""What is touched by requests that may have to wait for a change, or for each other."""

from __future__ import annotations

from cm.errors import CmError
from cm.manager.access.leases import scopes_written
from cm.manager.execution.worker import Change
from cm.manager.manager import Manager
from cm.schema.model import Memory
from cm.wire.messages import requests as rq


class Touched:
    """What requests touch in the mode that is loaded now."""

    def __init__(self, manager: Manager) -> None:
        self._manager = manager

    def touches(self, change: Change, request: rq.Request) -> bool:
        """Whether a change writes what this request writes, or loads its region."""
        config, mode = self._manager.loaded_config(), self._manager.state.mode
        memory = self._memory(request.stream) if isinstance(request, (rq.WriteData, rq.ConfigureStream)) else None
        return bool({"config", *scopes_written(request, config, mode, memory)} & set(change.scopes))

    def writes_memory(self, request: rq.Request) -> bool:
        """Whether it writes to a memory, and not to a stream."""
        return isinstance(request, rq.WriteData) and self._memory(request.stream) is not None

    def _memory(self, name: str) -> Memory | None:
        try:
            return self._manager.memories.find(name)
        except CmError:  # a name of another mode, or nothing is loaded: its handler says so
            return None

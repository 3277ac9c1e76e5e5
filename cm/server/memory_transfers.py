# SPDX-License-Identifier: Apache-2.0
"""Memories over ZeroMQ: long transfers go piece by piece, and the loop serves others in between."""

from __future__ import annotations

import time
from dataclasses import replace

from cm.manager.access.memory_service import MemoryService, Transfer
from cm.server.shares.clients import Client
from cm.server.steps import Done, Steps
from cm.wire.messages.status import ConfigInfo, FrameInfo


class MemoryTransfers:
    """Transfers of a client one after the other, clients by turns. Everything in the loop's thread."""

    def __init__(self, steps: Steps, memories: MemoryService) -> None:
        self._steps = steps
        self._memories = memories

    def described(self, info: ConfigInfo) -> ConfigInfo:
        """A configuration with the memories that were defined for it, if it is the loaded one."""
        blocks = self._memories.defined() if info.mode else ()
        return replace(info, memories=(*info.memories, *blocks)) if blocks else info

    def start(self, client: Client, transfer: Transfer, done: Done) -> None:
        """Begin a transfer, a read when its client has room for the answer.

        `done` is called once, now or later, with the error, if any. Raises Busy.
        """
        if transfer.write:
            self._steps.start(client, transfer, done)
            return
        reserved = 0

        def may_begin() -> bool:
            nonlocal reserved
            if client.has_room(transfer.length):
                reserved = transfer.length
                client.make(reserved)
            return reserved > 0

        def ended(problem: Exception | None) -> None:
            client.make(-reserved)
            done(problem)

        self._steps.start(client, transfer, ended, may_begin)


def frame_info(transfer: Transfer, config: str, mode: str) -> FrameInfo:
    """What accompanies the payload of a memory."""
    shape, dtype = transfer.form
    memory, length = transfer.memory, transfer.length
    return FrameInfo(memory.name, 0, time.monotonic_ns(), length, shape, dtype, config, mode, offset=transfer.offset)

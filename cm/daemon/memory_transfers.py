# SPDX-License-Identifier: Apache-2.0
"""Memories over ZeroMQ: long transfers go piece by piece, between which the loop serves everybody else."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from cm.daemon.loop import Loop
from cm.errors import Busy
from cm.manager.access.memory_service import MemoryService, Transfer
from cm.messages.status import ConfigInfo, FrameInfo

Done = Callable[[Exception | None], None]
WAITING_MAX = 16  # transfers; their data lie in memory


@dataclass(frozen=True, slots=True)
class _Job:
    transfer: Transfer
    done: Done


class MemoryTransfers:
    """Transfers one after the other, in the order of their requests. Everything in the loop's thread."""

    def __init__(self, loop: Loop, memories: MemoryService) -> None:
        self._loop = loop
        self._memories = memories
        self._waiting: deque[_Job] = deque()
        self._more = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)  # readable while transfers wait
        loop.add(self._more, self._go_on)

    def described(self, info: ConfigInfo) -> ConfigInfo:
        """A configuration with the memories that were defined for it, if it is the loaded one."""
        blocks = self._memories.defined() if info.mode else ()
        return replace(info, memories=(*info.memories, *blocks)) if blocks else info

    def start(self, transfer: Transfer, done: Done) -> None:
        """Begin a transfer; `done` is called once, now or later, with what went wrong. Raises Busy."""
        if len(self._waiting) >= WAITING_MAX:
            raise Busy(f"{WAITING_MAX} transfers from and to memories wait already; try again when one has ended")
        self._waiting.append(_Job(transfer, done))
        if len(self._waiting) == 1:
            try:
                self._step()
            finally:
                if self._waiting:
                    os.eventfd_write(self._more, 1)

    def close(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
        self._loop.remove(self._more)
        os.close(self._more)

    def _go_on(self) -> None:
        """One piece; the next when the loop has looked at everything else."""
        try:
            self._step()
        finally:
            if not self._waiting:
                os.eventfd_read(self._more)

    def _step(self) -> None:
        job = self._waiting[0]
        try:
            problem, ended = None, job.transfer.step()
        except Exception as error:  # noqa: BLE001 (handed to the client that asked)
            problem, ended = error, True
        if ended:
            self._waiting.popleft()
            job.done(problem)


def frame_info(transfer: Transfer, config: str, mode: str) -> FrameInfo:
    """What stands beside the payload of a memory."""
    shape, dtype = transfer.form
    memory, length = transfer.memory, transfer.length
    return FrameInfo(memory.name, 0, time.monotonic_ns(), length, shape, dtype, config, mode, offset=transfer.offset)

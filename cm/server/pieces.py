# SPDX-License-Identifier: Apache-2.0
"""Long work, piece by piece: the loop serves others in between, and clients take turns."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from time import monotonic_ns
from typing import Protocol

from cm.errors import Busy
from cm.server.loop import Loop, Timer
from cm.server.shares.budget import Budget
from cm.server.shares.turns import least

Done = Callable[[Exception | None], None]
WAITING_MAX = 16  # jobs of one client
_AGAIN = 0.005  # seconds until jobs that could not begin are asked again


class Work(Protocol):
    """A job that is done in pieces."""

    def step(self) -> bool:
        """Do the next piece; returns whether that was the last. An exception ends the job."""


class _Job:
    __slots__ = ("_may_begin", "_work", "begun", "done")

    def __init__(self, work: Work, done: Done, may_begin: Callable[[], bool]) -> None:
        self._work, self.done, self._may_begin = work, done, may_begin
        self.begun = False

    def ready(self) -> bool:
        """Whether its next piece may be done; asked until the first may."""
        self.begun = self.begun or self._may_begin()
        return self.begun

    def step(self) -> tuple[bool, Exception | None]:
        """Do a piece; returns whether the job has ended, and its error."""
        try:
            return self._work.step(), None
        except Exception as error:  # noqa: BLE001 (handed to the asker)
            return True, error


class Pieces:
    """A client's jobs one after the other; the next piece is of the client that has used least of the loop's time.

    Jobs of a client are in the order of its requests. Everything in the loop's thread.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._waiting: dict[Budget, deque[_Job]] = {}  # by client
        self._more = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)  # readable while a piece can be done
        self._again: Timer | None = None  # while none can
        loop.add(self._more, self._go_on)

    def start(self, client: Budget, work: Work, done: Done, may_begin: Callable[[], bool] = lambda: True) -> None:
        """Begin a job as soon as `may_begin` allows it, at once if nothing else waits. Raises Busy.

        `done` is called once, now or later, with the error, if any.
        """
        jobs = self._waiting.get(client)
        if jobs is None:
            client.comes()
            jobs = self._waiting[client] = deque()
        if len(jobs) >= WAITING_MAX:
            raise Busy(
                f"{WAITING_MAX} transfers and long requests of {client.name} wait already; try again when one ended"
            )
        jobs.append(_Job(work, done, may_begin))
        if len(jobs) == len(self._waiting) == 1:
            os.eventfd_write(self._more, 1)
            self._go_on()
        elif self._again is not None:
            self._wake()

    def close(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
        if self._again is not None:
            self._again.cancel()
        self._loop.remove(self._more)
        os.close(self._more)

    def _go_on(self) -> None:
        """Do one piece; the next, of another client, follows when the loop has looked at everything else."""
        client = least(client for client, jobs in self._waiting.items() if jobs[0].ready())
        if client is None:
            os.eventfd_read(self._more)
            self._again = self._loop.call_later(_AGAIN, self._wake)
            return
        try:
            self._step(client)
        finally:
            if not self._waiting:
                os.eventfd_read(self._more)

    def _wake(self) -> None:
        if self._again is not None:
            self._again.cancel()
            self._again = None
            os.eventfd_write(self._more, 1)

    def _step(self, client: Budget) -> None:
        client.goes()
        began, jobs = monotonic_ns(), self._waiting.pop(client)
        ended, problem = jobs[0].step()
        client.charge(monotonic_ns() - began)
        job = jobs.popleft() if ended else None
        if jobs:
            self._waiting[client] = jobs  # after others that have used as much
        if job is not None:
            job.done(problem)

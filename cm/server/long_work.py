# SPDX-License-Identifier: Apache-2.0
"""Work of clients that takes long: in steps of the loop, or, where it reads or writes files, in a thread beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

from cm.errors import Busy
from cm.server.client_quotas import PENDING, Client, Ring, Turn
from cm.server.sockets import Loop

NOT_YET = object()  # what a step yields that cannot be done yet
_STEP_INTERVAL = 0.005  # seconds until work that could not be done is asked again


class RoundRobin:
    """Runs generators, a step in each turn of the loop, round and round among their owners. The loop's thread."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._ring: Ring[Iterator[object]] = Ring()
        self._late = 0  # owners one after another that could do nothing, of what runs
        self._is_scheduled = False

    def count(self, user: object) -> int:
        """How much of a user's work waits."""
        return self._ring.count(user)

    def run(self, steps: Iterator[object], turn: Turn | None = None) -> None:
        """Take the steps, the first no earlier than in the next turn; those of one owner one after the other.

        Without a `turn` they are their own owner.
        """
        self._ring.add((id(steps), 0) if turn is None else turn, steps)
        self._late = 0
        self._schedule()

    def start(self, client: Client, steps: Iterator[object]) -> None:
        """Take a client's steps after those that it has begun before, the first at once if nothing else waits.

        Raises Busy.
        """
        if self._ring.count(client.account) >= PENDING:
            raise Busy(
                f"{PENDING} transfers and long requests of {client.account} wait already; try again when one ended"
            )
        alone = not self._ring
        self.run(steps, client.turn)
        if alone:
            self._step()

    def _schedule(self) -> None:
        if not self._is_scheduled:
            self._is_scheduled = True
            self._loop.call_soon(self._step_scheduled)

    def _step_scheduled(self) -> None:
        self._is_scheduled = False
        if self._ring:
            self._step()

    def _step(self) -> None:
        turn, steps = self._ring.take()
        try:
            said = next(steps, steps)
            if said is not steps:
                self._ring.put_back(turn, steps)
            self._late = self._late + 1 if said is NOT_YET else 0
        finally:
            if self._ring and self._late < len(self._ring):
                self._schedule()
            elif self._ring:
                self._late = 0
                self._loop.call_later(_STEP_INTERVAL, self._schedule)

    def close(self) -> None:
        """Forget what waits."""
        self._ring.clear()


_T = TypeVar("_T")
Result = Callable[[], _T]  # returns the job's result, or raises what it raised
_Job = tuple[Callable[[], Any], Callable[[Result[Any]], None]]


class FileThread:
    """Runs each client's jobs in the order of its requests; users take turns, and the clients of each.

    Used in the loop's thread; jobs run in another.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.thread = ThreadPoolExecutor(1, "cm-files")  # other work submitted to it waits for at most one job
        self._waiting: Ring[_Job] = Ring()
        self._runs = False

    def submit(self, client: Client, work: Callable[[], _T], then: Callable[[Result[_T]], None]) -> None:
        """Queue a client's job, and call `then` with its result in the loop's thread. Raises Busy."""
        if self._waiting.count(client.account) >= PENDING:
            raise Busy(f"{PENDING} requests of {client.account} for what takes long wait already; await a reply")
        self._waiting.add(client.turn, (work, then))
        self._run_next()

    def close(self) -> None:
        """Drop waiting jobs, and let the running one end."""
        self._waiting.clear()
        self.thread.shutdown()

    def _run_next(self) -> None:
        if self._runs or not self._waiting:
            return
        _, (work, then) = self._waiting.take()
        self._runs = True
        ended = partial(self._finish_job, then)
        self.thread.submit(work).add_done_callback(lambda done: self._loop.call_threadsafe(partial(ended, done)))

    def _finish_job(self, then: Callable[[Result[Any]], None], done: Future[Any]) -> None:
        self._runs = False
        self._run_next()
        then(done.result)

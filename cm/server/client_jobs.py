# SPDX-License-Identifier: Apache-2.0
"""Clients' jobs that read or write files: one after another, in a separate thread, while the loop goes on."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from time import thread_time_ns
from typing import Any, TypeVar

from cm.errors import Busy
from cm.server.loop import Loop
from cm.server.shares.budget import PENDING, Budget
from cm.server.shares.turns import least

_T = TypeVar("_T")
Result = Callable[[], _T]  # returns the job's result, or raises what it raised
_Job = tuple[Callable[[], Any], Callable[[Result[Any]], None]]


class ClientJobs:
    """Runs each client's jobs in the order of its requests, next that of the client that has used least.

    The processor time of a job counts as used, because the loop cannot have it meanwhile. Used in the loop's thread;
    jobs run in another.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.thread = ThreadPoolExecutor(1, "cm-files")  # other work submitted to it waits for at most one job
        self._waiting: dict[Budget, deque[_Job]] = {}
        self._runs = False

    def submit(self, client: Budget, work: Callable[[], _T], then: Callable[[Result[_T]], None]) -> None:
        """Queue a client's job, and call `then` with its result in the loop's thread. Raises Busy."""
        jobs = self._waiting.get(client)
        if jobs is None:
            client.comes()
            jobs = self._waiting[client] = deque()
        if len(jobs) >= PENDING:
            raise Busy(f"{PENDING} requests of {client.name} for what takes long wait already; await a reply")
        jobs.append((work, then))
        self._go_on()

    def close(self) -> None:
        """Drop waiting jobs, and let the running one end."""
        self._waiting.clear()
        self.thread.shutdown()

    def _go_on(self) -> None:
        client = None if self._runs else least(self._waiting)
        if client is None:
            return
        client.goes()
        jobs = self._waiting.pop(client)
        work, then = jobs.popleft()
        if jobs:
            self._waiting[client] = jobs  # after others that have used as much
        self._runs = True
        self.thread.submit(self._run, client, work, then)

    def _run(self, client: Budget, work: Callable[[], Any], then: Callable[[Result[Any]], None]) -> None:
        began, result = thread_time_ns(), _outcome(work)
        took = thread_time_ns() - began

        def ended() -> None:
            self._runs = False
            client.spend(took)
            self._go_on()
            then(result)

        self._loop.call_threadsafe(ended)


def _outcome(work: Callable[[], Any]) -> Result[Any]:
    try:
        done = work()
    except Exception as error:  # noqa: BLE001 (raised again in the loop's thread)
        return _raising(error)
    return lambda: done


def _raising(error: Exception) -> Result[Any]:
    def again() -> Any:
        raise error

    return again

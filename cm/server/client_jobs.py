# SPDX-License-Identifier: Apache-2.0
"""Clients' jobs that read or write files: one after another, in a separate thread, while the loop goes on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from cm.errors import Busy
from cm.server.shares import PENDING, Client, Ring
from cm.server.sockets import Loop

_T = TypeVar("_T")
Result = Callable[[], _T]  # returns the job's result, or raises what it raised
_Job = tuple[Callable[[], Any], Callable[[Result[Any]], None]]


class ClientJobs:
    """Runs each client's jobs in the order of its requests; clients take turns.

    Used in the loop's thread; jobs run in another.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.thread = ThreadPoolExecutor(1, "cm-files")  # other work submitted to it waits for at most one job
        self._waiting: Ring[Client, _Job] = Ring()
        self._runs = False

    def submit(self, client: Client, work: Callable[[], _T], then: Callable[[Result[_T]], None]) -> None:
        """Queue a client's job, and call `then` with its result in the loop's thread. Raises Busy."""
        if self._waiting.count(client) >= PENDING:
            raise Busy(f"{PENDING} requests of {client.name} for what takes long wait already; await a reply")
        self._waiting.add(client, (work, then))
        self._go_on()

    def close(self) -> None:
        """Drop waiting jobs, and let the running one end."""
        self._waiting.clear()
        self.thread.shutdown()

    def _go_on(self) -> None:
        if self._runs or not self._waiting:
            return
        _, (work, then) = self._waiting.take()
        self._runs = True
        self.thread.submit(self._run, work, then)

    def _run(self, work: Callable[[], Any], then: Callable[[Result[Any]], None]) -> None:
        result = _outcome(work)

        def ended() -> None:
            self._runs = False
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

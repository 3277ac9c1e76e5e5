# SPDX-License-Identifier: Apache-2.0
"""The blocking client of a fleet: that of `cm.networks.fleet.aio` in a loop of its own."""

from __future__ import annotations

import asyncio
import os
import threading
import weakref
from collections.abc import Coroutine, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any, TypeVar

from cm.client.frame import Frame
from cm.networks.fleet import aio
from cm.networks.fleet.change.coordinator import Outcome
from cm.networks.fleet.changing import Course, Progress, nothing
from cm.networks.fleet.clocks import Reading
from cm.networks.fleet.looking import ALL
from cm.wire.messages.fleet import BoardStatus, BundleState, FleetRecord, Policy
from cm.wire.messages.status import ErrorInfo, PlanInfo, RegValues

_T = TypeVar("_T")


class _Loop:
    """An event loop in a thread that ends with the process."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="cm-fleet", daemon=True)
        self._thread.start()

    def wait_for(self, coroutine: Coroutine[Any, Any, _T]) -> _T:
        future = asyncio.run_coroutine_threadsafe(coroutine, self.loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def end(self) -> None:
        """Twice is fine."""
        if not self.loop.is_closed():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join()
            self.loop.close()


def connect(
    router: str | Iterable[str] = (),
    *,
    config: str | os.PathLike[str] | None = None,
    caller: str = "",
    timeout: float = 10.0,
) -> Fleet:
    """A fleet, connected: ``with cm.networks.fleet.connect("tcp/router:7447") as fleet: fleet.mode("edge_detection")``.

    `router`: zenoh's ``tcp/host:port`` or ``tls/host:port`` (default: `$CM_FLEET`, or else whoever is found on this
    network). `config`: a file of zenoh's settings, as ``cm fleet keys`` writes them. `caller`: the name to make
    requests under; with certificates the one in your own, else this user's. `timeout`: seconds for an answer. Raises
    NoNetwork, InvalidRequest for a caller's name that cannot be part of a key.
    """
    return Fleet(aio.connect(router, config=config, caller=caller, timeout=timeout))


class Fleet:
    """Many boards, with calls that block. Groups of boards are names, globs (``line1-*``) and labels (``@camera``)."""

    def __init__(self, fleet: aio.Fleet) -> None:
        self._loop = _Loop()
        self._fleet = fleet
        self._end = weakref.finalize(self, self._loop.end)
        try:
            self._loop.wait_for(fleet.__aenter__())
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> Fleet:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; twice is fine."""
        if self._end.alive:
            self._loop.wait_for(self._fleet.close())
            self._end()

    @property
    def caller(self) -> str:
        """The name under which requests are made: each board's manager knows it as its guest ``zenoh:<name>``."""
        return self._fleet.caller

    def boards(self) -> tuple[str, ...]:
        """Names of all boards whose bridges are running, sorted."""
        return self._loop.wait_for(self._fleet.boards())

    def chosen(self, boards: Iterable[str] = ALL) -> tuple[str, ...]:
        """The boards of a group, sorted: by name, glob or ``@label``. Raises NoSuchBoard for one that matches none."""
        return self._loop.wait_for(self._fleet.chosen(boards))

    def status(self, boards: Iterable[str] = ALL) -> dict[str, BoardStatus | ErrorInfo]:
        """The status of each board, or why there is none (code ``no_answer``, or what its manager said).

        Raises NoSuchBoard for a glob or a label that matches none; a name that does not exist gets an error.
        """
        return self._loop.wait_for(self._fleet.status(boards))

    def plan(self, mode: str = "", config: str = "", boards: Iterable[str] = ALL) -> dict[str, PlanInfo | ErrorInfo]:
        """What a change would do on each board, in steps, bytes and seconds; touches nothing.

        Without `mode` to the default mode, without `config` of the loaded configuration. Raises NoSuchBoard.
        """
        return self._loop.wait_for(self._fleet.plan(mode, config, boards))

    def read(self, register: str, boards: Iterable[str] = ALL) -> dict[str, RegValues | ErrorInfo]:
        """A register, or ``register.field``, of each board. Raises NoSuchBoard, InvalidRequest (a name with ``/``)."""
        return self._loop.wait_for(self._fleet.read(register, boards))

    def write(self, values: Mapping[str, int | str], boards: Iterable[str] = ALL) -> dict[str, RegValues | ErrorInfo]:
        """Write registers on each board, in order; each board does all of it or nothing, and answers for itself.

        Raises NoSuchBoard.
        """
        return self._loop.wait_for(self._fleet.write(values, boards))

    def frame(self, board: str, stream: str) -> Frame:
        """The next frame of a stream of one board, as an array of the stream's shape. Raises RequestFailed."""
        return self._loop.wait_for(self._fleet.frame(board, stream))

    def send(self, board: str, stream: str, data: Any) -> None:
        """An array or bytes for a stream of one board; returns when the hardware has taken it. Raises RequestFailed."""
        self._loop.wait_for(self._fleet.send(board, stream, data))

    def clocks(self, boards: Iterable[str] = ALL) -> dict[str, Reading | ErrorInfo]:
        """How far each board's clock may be off, ns: as it says itself, and the bounds measured from here.

        Raises NoSuchBoard.
        """
        return self._loop.wait_for(self._fleet.clocks(boards))

    def load(
        self,
        config: str = "",
        mode: str = "",
        boards: Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        timeout: float = 60.0,
        settle: float = 0.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take all boards to a mode, or none: plan on all, prepare all, change all, then keep the new mode or go back.

        `policy`: ``all``, ``quorum`` or ``best-effort``: how many boards must succeed for the change to be kept.
        `timeout`: seconds for each phase. `settle`: seconds after which a board that hears nothing asks what was
        decided (0: twice `timeout`). `tell` is called with the phase, a board, and its answer, in another thread.
        Returns the outcome with the critical path. Raises NoSuchBoard, FleetRefused (nothing was touched), ChangeFailed
        (its outcome names each board that differs).
        """
        changing = self._fleet.load(config, mode, boards, policy=policy, timeout=timeout, settle=settle, tell=tell)
        return self._loop.wait_for(changing)

    def mode(
        self,
        mode: str,
        boards: Iterable[str] = ALL,
        *,
        policy: Policy | str = Policy.ALL,
        timeout: float = 60.0,
        settle: float = 0.0,
        tell: Progress = nothing,
    ) -> Course:
        """Take all boards to a mode of what they have loaded, or none; as `load`."""
        return self.load("", mode, boards, policy=policy, timeout=timeout, settle=settle, tell=tell)

    def recover(self, change: str = "", boards: Iterable[str] = ALL) -> dict[str, Outcome]:
        """End changes whose client is gone, by the boards' own records; returns each change's outcome, by its name.

        A majority of the seats of a change can decide it, or any board that knows the decision. Without `change`: all
        that are open on these boards and whose time is over; with it that one, at once. An outcome whose decision is
        None has too few seats left: its boards are named, and keep waiting. Raises NoSuchBoard, NotFound (no board has
        that change).
        """
        return self._loop.wait_for(self._fleet.recover(change, boards))

    def settle(self, change: str, keep: bool, boards: Iterable[str] = ALL) -> dict[str, FleetRecord | ErrorInfo]:
        """Decide in place of seats that will never come back: if they do, they may contradict it.

        Returns the record of each board, or its error. Raises NoSuchBoard, NotFound (no board has that change),
        InvalidRequest if the change is decided, or can be decided without this, differently.
        """
        return self._loop.wait_for(self._fleet.settle(change, keep, boards))

    def push(
        self, archive: str | os.PathLike[str], boards: Iterable[str] = ALL, *, timeout: float = 600.0
    ) -> dict[str, BundleState | ErrorInfo]:
        """Have boards fetch an archive of ``cm build collect`` from here and put it in force.

        `timeout` in seconds, for all of it. Parts that have reached a board stay there: a repeated push continues.
        Raises NoSuchBoard, NotFound (no such file), OSError.
        """
        return self._loop.wait_for(self._fleet.push(archive, boards, timeout=timeout))

    @contextmanager
    def watch(self, boards: str = "*") -> Iterator[Iterator[tuple[str, BoardStatus | None]]]:
        """Statuses of boards as they change, and each second; None when a board has gone. One name, or ``*``.

        ``with fleet.watch() as statuses: for name, status in statuses: ...``. If more than a thousand wait to be
        read, the oldest are lost.
        """
        context = self._fleet.watch(boards)
        statuses = self._loop.wait_for(context.__aenter__())
        try:
            yield self._each(statuses)
        finally:
            self._loop.wait_for(context.__aexit__(None, None, None))

    def _each(self, statuses: Any) -> Iterator[tuple[str, BoardStatus | None]]:
        while True:
            yield self._loop.wait_for(anext(statuses))

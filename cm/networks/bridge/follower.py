# SPDX-License-Identifier: Apache-2.0
"""Follows a manager and tells a bridge what happens, as records; if the manager goes away, waits until it is back."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from cm.client.board import Board
from cm.client.core import calls
from cm.errors import CmError
from cm.networks.bridge.records import ConfigRecord, config_record
from cm.wire import topics
from cm.wire.encode import decode_event
from cm.wire.messages.status import ConfigInfo, Irq, RegValues, Status

ENDED = "the bridge ends"  # the last thing that `link` is told
_LOOK = 1.0  # seconds between two checks whether the manager is there, and between two tries to connect


class Sink(Protocol):
    """What a bridge does with what happens: called in the follower's thread, one call at a time.

    Stamps are wall time by the board's clock, ns: when it happened, or else when the bridge learned of it.
    """

    def link(self, board: Board | None, problem: str) -> None:
        """The manager is there (a connection that may be used until the next call), or not, and why."""

    def status(self, status: Status, stamp_ns: int) -> None:
        """A status: the first after each connection, then each that is published."""

    def config(self, record: ConfigRecord) -> None:
        """Another configuration or mode runs, or its settings have changed; called after the status that says so."""

    def registers(self, values: RegValues, stamp_ns: int) -> None:
        """Registers were written, by any client: their new values."""

    def interrupt(self, irq: Irq, stamp_ns: int) -> None:
        """An interrupt came."""


class Follower:
    """`run` follows, in the thread that calls it, until `stop`."""

    def __init__(self, connect: Callable[[], Board], sink: Sink, patience: float = 5.0) -> None:
        """`patience`: seconds that a manager may leave unanswered before it counts as gone."""
        self._patience = patience
        self._connect = connect
        self._sink = sink
        self._stopped = threading.Event()
        self._wake, self._ring = os.pipe()
        self._board: Board | None = None
        self._offset = 0
        self._place: Any = None

    def run(self) -> None:
        """Until `stop`. Raises what the sink raises; a manager that is gone, or refuses us, is told to `link`."""
        try:
            while not self._stopped.is_set():
                try:
                    with self._connect() as board:
                        self._board = board
                        self._follow(board)
                except (CmError, ConnectionError) as error:
                    if not self._stopped.is_set():
                        self._sink.link(None, str(error))
                self._stopped.wait(_LOOK)
            self._sink.link(None, ENDED)
        finally:
            os.close(self._wake)

    def stop(self) -> None:
        """End `run`, from any thread or signal handler; twice is fine."""
        if not self._stopped.is_set():
            self._stopped.set()
            os.close(self._ring)  # makes the other end readable
            if self._board is not None:
                self._board.close()  # frees a call that waits for an answer

    def _follow(self, board: Board) -> None:
        if self._stopped.is_set():
            return
        subscription = board.subscribe(topics.STATUS, topics.READ_REG, topics.IRQ)
        readable = select.poll()
        for descriptor in (subscription.fileno(), self._wake):
            readable.register(descriptor, select.POLLIN | select.POLLHUP)
        try:
            self._place = None
            self._offset = board.status.realtime_offset_ns
            self._sink.link(board, "")
            look = time.monotonic() + _LOOK
            while not self._stopped.is_set():
                readable.poll(max(0.0, look - time.monotonic()) * 1000)
                while not self._stopped.is_set() and (frames := subscription.receive(0.0)) is not None:
                    self._take(board, decode_event(frames))
                if time.monotonic() >= look:
                    # A subscription would wait for ever, while a request fails if the manager has gone.
                    self._offset = board.ask(calls.status(), self._patience).realtime_offset_ns
                    look = time.monotonic() + _LOOK
        finally:
            with suppress(CmError):
                subscription.close()

    def _take(self, board: Board, event: object) -> None:
        if isinstance(event, Status):
            self._status(board, event)
        elif isinstance(event, RegValues):
            self._sink.registers(event, time.time_ns())
        elif isinstance(event, Irq):
            self._sink.interrupt(event, event.timestamp_ns + self._offset)

    def _status(self, board: Board, status: Status) -> None:
        self._offset, stamp = status.realtime_offset_ns, time.time_ns()
        self._sink.status(status, stamp)
        place = _place(status)
        if place != self._place and not status.fpga_busy:  # during a change the two may be of different modes
            self._place = place
            config = board.config() if status.config_name else ConfigInfo()
            self._sink.config(config_record(status, config, stamp))


def _place(status: Status) -> object:
    """What a description is valid for: if this differs, ask for another."""
    streams = tuple((s.name, s.shape, s.dtype) for s in status.streams)
    modules = tuple((region.name, region.module) for region in status.regions)
    return status.started_ns, status.config_name, status.mode, status.configs, streams, modules

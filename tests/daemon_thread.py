# SPDX-License-Identifier: Apache-2.0
"""The daemon in a thread of the test's process, used over its sockets like by any client."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import zmq
from manager_process import CAMERA, short_folder

from cm.device import Root
from cm.schema import load_folder
from cm.server.options import Options
from cm.server.server import Server
from cm.simulation.software import Board as SimBoard
from cm.wire.encode import Event, decode_event, decode_reply, encode_request
from cm.wire.messages import requests as rq
from cm.wire.messages.status import Reply, Status, StreamStatus

HUNG = 60_000  # milliseconds


class Daemon:
    """A manager that serves `folder`, on a board."""

    def __init__(self, folder: Path, board: SimBoard, schemas: Path = CAMERA, **options: Any) -> None:
        self.folder = folder
        self.board = board
        given = Options(folder / "run", folder / "state", Root.of(board.root), load_folder(schemas), **options)
        self.server = Server(given)
        self._ready = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        assert self._ready.wait(HUNG / 1000)
        if self._failure is not None:
            raise self._failure
        self._context = zmq.Context()
        self._req = self.connect(zmq.DEALER, "req")

    def _serve(self) -> None:
        try:
            self.server.serve(self._ready.set)
        except Exception as error:  # noqa: BLE001 (raised again where it was started)
            self._failure = error
            self._ready.set()

    def close(self) -> None:
        """Close it; calling this twice is harmless."""
        if self._context.closed:
            return
        self.server.stop()
        self._context.destroy(linger=0)
        self._thread.join(HUNG / 1000)
        assert not self._thread.is_alive()

    def connect(self, kind: int, name: str) -> Any:
        """A socket of a client: `req`, `pub` (publications) or `sub` (requests without a reply)."""
        made = self._context.socket(kind)
        made.rcvtimeo = HUNG
        made.connect(f"ipc://{self.folder}/run/{name}")
        return made

    def send(self, request: rq.Request) -> None:
        self._req.send_multipart([b"", *encode_request(request)])

    def reply(self) -> Reply:
        return decode_reply(self._req.recv_multipart()[1:])

    def ask(self, request: rq.Request) -> Reply:
        self.send(request)
        return self.reply()

    def done(self, request: rq.Request) -> Any:
        """The body of a reply, which must not be an error."""
        reply = self.ask(request)
        assert reply.error is None, reply.error
        return reply.body

    def refused(self, request: rq.Request) -> tuple[str, str]:
        """Code and sentence of a refusal."""
        reply = self.ask(request)
        assert reply.error is not None, reply.body
        return reply.error.code, reply.error.message

    def raw(self, *frames: bytes) -> Reply:
        self._req.send_multipart([b"", *frames])
        return self.reply()

    @property
    def status(self) -> Status:
        return self.done(rq.ReadStatus())

    def stream(self, name: str) -> StreamStatus:
        return next(stream for stream in self.status.streams if stream.name == name)

    def load(self, mode: str) -> None:
        self.done(rq.ChangeMode("camera", mode))


class Subscriber:
    """A SUB socket whose subscriptions are in effect once they are made."""

    def __init__(self, daemon: Daemon, *subscribed: bytes) -> None:
        self._socket = daemon.connect(zmq.SUB, "pub")
        for topic in subscribed:
            self._socket.setsockopt(zmq.SUBSCRIBE, topic)
        self._socket.setsockopt(zmq.SUBSCRIBE, b"cm_status")
        self.first: Status = self.event()  # the status comes at once, after the subscriptions

    def event(self) -> Any:
        return self.frames()[0]

    def frames(self) -> tuple[Event, list[bytes]]:
        frames = self._socket.recv_multipart()
        return decode_event(frames), frames

    def until(self, kind: type, accept: Any = lambda _: True) -> Any:
        while True:
            event = self.event()
            if isinstance(event, kind) and accept(event):
                return event

    def close(self) -> None:
        self._socket.close(linger=0)


@contextlib.contextmanager
def daemon(board: Sequence[str] = (), schemas: Path = CAMERA, **options: Any) -> Iterator[Daemon]:
    """A daemon on a simulated board whose ports take no time; `board`: further arguments of `cm sim`."""
    fast = ["--icap-rate", "0", "--pcap-rate", "0"]
    with short_folder() as folder, SimBoard([schemas], root=folder / "board", arguments=[*fast, *board]) as sim:
        made = Daemon(folder, sim, schemas, **options)
        with defects() as found:
            try:
                yield made
            finally:
                made.close()
        assert not found, found


@contextlib.contextmanager
def defects() -> Iterator[list[str]]:
    """What callbacks of the loop raised, which the loop logs and survives."""
    found: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: found.append(  # type: ignore[method-assign]
        f"{record.getMessage()}: {record.exc_info[1]!r}" if record.exc_info else record.getMessage()
    )
    log = logging.getLogger("cm.server.sockets")
    log.addHandler(handler)
    try:
        yield found
    finally:
        log.removeHandler(handler)

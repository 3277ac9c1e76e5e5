# SPDX-License-Identifier: Apache-2.0
"""pyzmq REQ/REP over ipc with the frames of a control request and its reply, taken from files in the folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import zmq

_FRAMES = "{}.frames"  # one line of hexadecimal digits for each frame


def put(folder: Path, request: Sequence[bytes], reply: Sequence[bytes]) -> None:
    """Write down what to send and what to reply."""
    for name, frames in (("request", request), ("reply", reply)):
        (folder / _FRAMES.format(name)).write_text("\n".join(bytes(f).hex() for f in frames), encoding="ascii")


def get(folder: Path, name: str) -> list[bytes]:
    """The frames."""
    text = (folder / _FRAMES.format(name)).read_text(encoding="ascii")
    return [bytes.fromhex(line) for line in text.split("\n")]


class Asking:
    """A REQ socket that repeats one request."""

    def __init__(self, address: str, request: Sequence[bytes]) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.connect(address)
        self.request = request

    def trip(self) -> list[bytes]:
        """There and back."""
        self._socket.send_multipart(self.request)
        return self._socket.recv_multipart()

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()
        self._context.term()


def near(folder: Path, size: int) -> Asking:  # noqa: ARG001 (of the frames)
    """This end."""
    return Asking(f"ipc://{folder}/zmq", get(folder, "request"))


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:  # noqa: ARG001 (of the frames)
    """The other end."""
    answer(folder, ready, lambda: None)


def answer(folder: Path, ready: Callable[[], None], work: Callable[[], object]) -> None:
    """Answer each request, after `work`."""
    reply = get(folder, "reply")
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.REP)
    socket.bind(f"ipc://{folder}/zmq")
    ready()
    while True:
        socket.recv_multipart()
        work()
        socket.send_multipart(reply)

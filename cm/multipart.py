# SPDX-License-Identifier: Apache-2.0
"""ZeroMQ messages of several frames, in a third of the time of pyzmq's own methods.

`Socket.send_multipart` builds each frame's flags from enumerations and `recv_multipart` asks the socket
for RCVMORE behind each frame; small requests spend more time there than in libzmq. A `zmq.Frame` knows
whether more follow.
"""

from __future__ import annotations

from collections.abc import Sequence

import zmq

_MORE = int(zmq.SNDMORE)
# What `zmq.Socket.send` calls after it has looked for a routing id and a group, which only draft sockets have:
# 0.15 µs less for a frame in a tight loop, 4 % of a register's round trip (docs/decisions/own-event-loop.md).
_push = super(zmq.Socket, zmq.Socket).send
_SMALL = 4096  # bytes; larger frames stay where libzmq put them


def send(socket: zmq.Socket[bytes], frames: Sequence[bytes | memoryview], flags: int = 0) -> None:
    """As `send_multipart`; at least one frame."""
    for frame in frames[:-1]:
        _push(socket, frame, flags | _MORE)
    _push(socket, frames[-1], flags)


def receive_from(socket: zmq.Socket[bytes], flags: int = 0) -> tuple[str, list[bytes | memoryview]]:
    """As `receive`, and the user id that authentication gave the connection; empty where it gave none."""
    pull = socket.recv
    frames: list[bytes | memoryview] = []
    more = True
    while more:
        frame = pull(flags, False)
        frames.append(frame.bytes if len(frame) <= _SMALL else frame.buffer)
        more = frame.more
    try:  # of the last frame: libzmq 4.3.4 knows none of a routing id that it read ahead, as after a poll
        return str(frame.get("User-Id")), frames
    except zmq.ZMQError:
        return "", frames


def receive(socket: zmq.Socket[bytes], flags: int = 0) -> list[bytes | memoryview]:
    """As `recv_multipart`, but large frames are views of ZeroMQ's own memory. Raises zmq.Again."""
    pull = socket.recv
    frames: list[bytes | memoryview] = []
    more = True
    while more:
        frame = pull(flags, False)
        frames.append(frame.bytes if len(frame) <= _SMALL else frame.buffer)
        more = frame.more
    return frames

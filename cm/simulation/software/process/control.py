# SPDX-License-Identifier: Apache-2.0
"""A client of the simulator's own control: faults by name, camera steps, the board's state."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from typing import Any

from cm.simulation.software.errors import SimError
from cm.simulation.software.faults import KINDS
from cm.simulation.software.transport import protocol

_COMPILED = 300.0  # seconds: where modules run by their bits, those with a bit turned over are compiled
_TIMEOUT = 10.0


class Control:
    """Tells a running simulator what to do; each call is one connection."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)

    def inject(self, name: str, target: str | None = None, count: int = 1, value: int = 0, after: int = 0) -> None:
        """Order a fault, `count` times (0: until cleared), once `after` more loads have ended.

        See `KINDS` for names, targets and values.

        Raises:
            SimError: there is no such fault or target, or no simulator at the root.
        """
        _check_kind(name)
        self._order("inject", kind=name, target=target, count=count, value=value, after=after)

    def clear(self, name: str | None = None, target: str | None = None) -> None:
        """Forget the faults of that name and target that still wait (None: all). Raises SimError as `inject` does."""
        if name:
            _check_kind(name)
        self._order("clear", kind=name, target=target)

    def interrupt(self, name: str) -> None:
        """Raise an interrupt by name."""
        self._order("interrupt", name=name)

    def pause(self, channel: str) -> None:
        """Hold a camera; its buffers wait."""
        self._order("pause", channel=channel)

    def step(self, channel: str, frames: int = 1) -> None:
        """Let a paused camera give that many more frames."""
        self._order("step", channel=channel, frames=frames)

    def resume(self, channel: str) -> None:
        """Let a camera run again."""
        self._order("resume", channel=channel)

    def frame(self, channel: str, file: Path | str) -> None:
        """Let the bytes of a file leave on a channel, as if the hardware had sent them, when it has room for them.

        Raises SimError, also where many wait already.
        """
        self._order("frame", channel=channel, file=str(Path(file).absolute()))

    def register(self, name: str, value: int) -> None:
        """Let the hardware itself put a value into a register."""
        self._order("register", name=name, value=value)

    def reset(self) -> None:
        """Empty all regions and reset all registers, as power-up does."""
        self._order("reset")

    def upset(
        self, region: str, bits: int = 1, frame: int | None = None, bit: int | None = None
    ) -> list[tuple[int, int]]:
        """Turn over bits of a region's frames: in random places, or in a frame by its address, and there a bit.

        Returns frame address, and 32 times the word and the bit in it, of each. Raises SimError.
        """
        self._order("upset", patience=_COMPILED, region=region, bits=bits, frame=frame, bit=bit)
        return [(far, at) for far, at in self.state()["upsets"]]

    def trace(self, folder: Path | str | None) -> None:
        """Write the signals of the RTL to files in a folder; None ends that.

        Raises:
            SimError: the logic has no signals, or was compiled without traces
                (``python -m cm.simulation.rtl --traces``).
        """
        self._order("trace", folder=str(Path(folder).absolute()) if folder else "")

    def adopt(self) -> None:
        """Make this process the owner of a simulator whose owner has died.

        Raises:
            SimError: its owner is alive, or it has none, or there is no simulator at the root.
        """
        self._order("adopt", pid=os.getpid())

    def state(self) -> dict[str, Any]:
        """Modules, decoupling, channels, buffers, connections and waiting faults."""
        state: dict[str, Any] = json.loads(self._call(protocol.OP_ATTR_READ, b""))
        return state

    def _order(self, do: str, *, patience: float = _TIMEOUT, **parts: object) -> None:
        self._call(protocol.OP_ATTR_WRITE, json.dumps({"do": do, **parts}).encode(), patience)

    def _call(self, op: int, payload: bytes, patience: float = _TIMEOUT) -> bytes:
        with self._connect() as sock:
            sock.settimeout(patience)
            try:
                _receive(sock)
                sock.send(protocol.REQUEST.pack(op, len(payload)) + payload)
                return _receive(sock)
            except (TimeoutError, ConnectionError) as error:
                raise SimError(f"the simulator at {self.root} does not answer: {error}") from error

    def _connect(self) -> socket.socket:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        sock.settimeout(_TIMEOUT)
        try:
            fd = os.open(self.root / protocol.CONTROL_PATH, os.O_PATH)
            try:
                sock.connect(f"/proc/self/fd/{fd}")
            finally:
                os.close(fd)
        except OSError as error:
            sock.close()
            raise SimError(
                f"no simulator serves {self.root}: {error.strerror or error}; start one with cm sim --root {self.root}"
            ) from error
        return sock


def _check_kind(name: str) -> None:
    if name not in KINDS:
        raise SimError(f"no fault is called {name}; there are {', '.join(KINDS)}")


def _receive(sock: socket.socket) -> bytes:
    data, fds, _, _ = socket.recv_fds(sock, protocol.PAYLOAD_MAX + protocol.REPLY.size, 1)
    for fd in fds:
        os.close(fd)
    if len(data) < protocol.REPLY.size:
        raise ConnectionResetError("the connection ended")
    _, error, _, _ = protocol.REPLY.unpack_from(data)
    if error:
        why = data[protocol.REPLY.size :].decode(errors="replace")
        raise SimError(why or f"the simulator refuses: {os.strerror(error)}")
    return data[protocol.REPLY.size :]

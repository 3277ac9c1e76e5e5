# SPDX-License-Identifier: Apache-2.0
"""Programs on a board, run by QEMU's guest agent: no network, no shell of ours, nothing of ours on the board."""

from __future__ import annotations

import base64
import itertools
import json
import socket
import time
from dataclasses import dataclass
from pathlib import Path

from vmboard.errors import VmError


@dataclass(frozen=True, slots=True)
class Done:
    """How a program ended, and what it wrote."""

    status: int
    out: str
    err: str

    @property
    def said(self) -> str:
        """Everything it wrote."""
        return self.out + self.err


@dataclass(frozen=True, slots=True)
class Program:
    """One that was started."""

    pid: object  # as the agent knows it
    command: list[str]


class Agent:
    """One connection to the agent behind a socket of QEMU."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.connect(str(path))
        self._pending = b""
        self._numbers = itertools.count(int(time.time()) % 100000)

    def close(self) -> None:
        """Close the connection; programs go on."""
        self._socket.close()

    def answers(self, patience_s: float) -> bool:
        """Whether the agent has started; what others left unread is thrown away."""
        number = next(self._numbers)
        deadline = time.monotonic() + patience_s
        self._socket.settimeout(patience_s)
        try:
            self._send("guest-sync", {"id": number})
        except TimeoutError:  # nobody has read for so long that no more questions go in
            return False
        while (left := deadline - time.monotonic()) > 0:
            reply = self._reply(left)
            if reply is not None and reply.get("return") == number:
                return True
        return False

    def run(self, command: list[str], patience_s: float, given: str = "") -> Done:
        """Run a program to its end; raises VmError where that takes longer than `patience_s`."""
        return self.end(self.begin(command, patience_s, given), patience_s)

    def begin(self, command: list[str], patience_s: float, given: str = "") -> Program:
        """Start a program, that runs beside others until its `end`."""
        arguments: dict[str, object] = {"path": command[0], "arg": command[1:], "capture-output": True}
        if given:
            arguments["input-data"] = base64.b64encode(given.encode()).decode()
        return Program(self._call("guest-exec", arguments, patience_s)["pid"], command)

    def end(self, program: Program, patience_s: float) -> Done:
        """Wait until a program has ended; raises VmError where that takes longer than `patience_s`."""
        deadline, pause = time.monotonic() + patience_s, 0.05
        while time.monotonic() < deadline:
            state = self._call("guest-exec-status", {"pid": program.pid}, patience_s)
            if state["exited"]:
                return Done(_status(state), _text(state, "out-data"), _text(state, "err-data"))
            time.sleep(pause)
            pause = min(2 * pause, 0.4)  # each question is work for the board
        raise VmError(f"the board did not come to the end of {' '.join(program.command)} in {patience_s:.0f} s")

    def _call(self, name: str, arguments: dict[str, object], patience_s: float) -> dict[str, object]:
        self._send(name, arguments)
        reply = self._reply(patience_s)
        if reply is None:
            raise VmError(f"the board's agent did not answer {name} in {patience_s:.0f} s")
        result = reply.get("return")
        if not isinstance(result, dict):
            raise VmError(f"the board's agent refused {name} {arguments}: {reply}")
        return result

    def _send(self, name: str, arguments: dict[str, object]) -> None:
        self._socket.sendall(json.dumps({"execute": name, "arguments": arguments}).encode() + b"\n")

    def _reply(self, patience_s: float) -> dict[str, object] | None:
        self._socket.settimeout(patience_s)
        try:
            while b"\n" not in self._pending:
                piece = self._socket.recv(65536)
                if not piece:
                    raise VmError("the board has gone")
                self._pending += piece
        except TimeoutError:
            return None
        except ConnectionError:
            raise VmError("the board has gone") from None
        line, self._pending = self._pending.split(b"\n", 1)
        reply = json.loads(line)
        return reply if isinstance(reply, dict) else None


def _status(state: dict[str, object]) -> int:
    status = state.get("exitcode", -1)  # absent where a signal ended it
    return status if isinstance(status, int) else -1


def _text(state: dict[str, object], name: str) -> str:
    packed = state.get(name)
    return base64.b64decode(packed).decode(errors="replace") if isinstance(packed, str) else ""

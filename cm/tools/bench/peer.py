# SPDX-License-Identifier: Apache-2.0
"""The far end of a baseline, a process of its own: ``python -m cm.tools.bench.peer KIND FOLDER BYTES``."""

from __future__ import annotations

import importlib
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Protocol, cast

from cm import child
from cm.errors import CmError, Timeout

INSTALL = "not available: pip install 'fpga-cm[bench]'"
_PATIENCE = 60.0  # seconds, on a loaded machine


class Kind(NamedTuple):
    """A baseline: its module here, and the package that it needs, which may be missing."""

    module: str
    needs: str | None = None


KINDS = {
    "zmq": Kind("cm.tools.bench.peers.zmq_echo"),
    "zmq_tcp": Kind("cm.tools.bench.peers.zmq_tcp"),
    "zmq_reply": Kind("cm.tools.bench.peers.zmq_reply"),
    "zmq_board": Kind("cm.tools.bench.peers.zmq_board"),
    "iceoryx2": Kind("cm.tools.bench.peers.iceoryx2_events", "iceoryx2"),
    "zenoh": Kind("cm.tools.bench.peers.zenoh_shm", "zenoh"),
    "zenoh_pictures": Kind("cm.tools.bench.peers.zenoh_pictures", "zenoh"),
}


class Unavailable(CmError):
    """A baseline that this machine cannot run; the message says why."""

    code = "unavailable"


class Near(Protocol):
    """The end in the measuring process."""

    def trip(self) -> object:
        """There and back."""

    def close(self) -> None:
        """Release what it holds."""


class PeerModule(Protocol):
    """The functions of a baseline's module."""

    def near(self, folder: Path, size: int) -> Near:
        """This end."""

    def far(self, folder: Path, size: int, ready: Callable[[], None]) -> None:
        """The other end: serves until it is killed; calls `ready` when it can be reached."""


def load(kind: str) -> PeerModule:
    """A baseline's module. Raises Unavailable."""
    entry = KINDS[kind]
    try:
        if entry.needs:
            importlib.import_module(entry.needs)
        return cast(PeerModule, importlib.import_module(entry.module))
    except ImportError as error:
        raise Unavailable(INSTALL) from error


class Peer:
    """A baseline with both its ends, as a context manager; `trip()` goes there and back."""

    def __init__(self, kind: str, folder: Path, size: int) -> None:
        module = load(kind)
        folder.mkdir(parents=True, exist_ok=True)
        command = child.command("cm.tools.bench.peer", kind, str(folder), str(size))
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, env=child.environment()
        )
        try:
            self._await_ready(kind)
            self.near = module.near(folder, size)
        except BaseException:
            self._end()
            raise
        self.trip = self.near.trip

    @property
    def pid(self) -> int:
        """Of the far end."""
        return self._process.pid

    def _await_ready(self, kind: str) -> None:
        assert self._process.stdout is not None
        ready, _, _ = select.select([self._process.stdout], [], [], _PATIENCE)
        line = self._process.stdout.readline() if ready else b""
        if line.startswith(b"unavailable "):
            raise Unavailable(line.decode().removeprefix("unavailable ").strip())
        if line != b"ready\n":
            raise Timeout(f"the far end of {kind} did not start (it said {line!r})")

    def _end(self) -> None:
        self._process.kill()
        self._process.communicate()

    def __enter__(self) -> Peer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.near.close()
        self._end()


def _end_with_parent(parent: int) -> None:
    """Ends with the bench, even if that is killed, so that no process is left behind."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


def main(arguments: list[str]) -> int:
    """Serve as the far end."""
    import threading

    kind, folder, size = arguments
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    try:
        load(kind).far(Path(folder), int(size), lambda: print("ready", flush=True))
    except Unavailable as why:
        print(f"unavailable {why}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

# SPDX-License-Identifier: Apache-2.0
"""The far end of a baseline, a process of its own: ``python -m cm.tools.bench.peer KIND FOLDER BYTES``."""

from __future__ import annotations

import importlib
import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from cm import child
from cm.errors import CmError, Timeout

INSTALL = "not available: pip install 'fpga-cm[bench]'"
_PATIENCE = 60.0  # seconds, on a loaded machine


KINDS = {
    "zmq": "zmq_echo",
    "zmq_tcp": "zmq_tcp",
    "zmq_reply": "zmq_reply",
    "zmq_board": "zmq_board",
    "iceoryx2": "iceoryx2_events",
    "zenoh": "zenoh_shm",
    "zenoh_pictures": "zenoh_pictures",
}  # modules of `cm.tools.bench.peers`; the package that one is about may be missing


class Unavailable(CmError):
    """A baseline that this machine cannot run; the message says why."""

    code = "unavailable"


def load(kind: str) -> Any:
    """A baseline's module. Raises Unavailable."""
    try:
        return importlib.import_module(f"cm.tools.bench.peers.{KINDS[kind]}")
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
        self.trip: Any = getattr(self.near, "trip", None)

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

    def __exit__(self, *_: object) -> None:
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

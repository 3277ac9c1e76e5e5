# SPDX-License-Identifier: Apache-2.0
"""Simulated boards with managers and bridges, and a router: a whole fleet in processes of this machine."""

from __future__ import annotations

import contextlib
import random
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from cm import child
from cm.errors import CmError, Timeout

_PATIENCE = 120.0  # seconds, on a loaded machine
_SETTINGS = 'access:\n  guests: {"*": operate}\n'


class FleetFailed(CmError):
    """A process of the fleet did not start."""

    code = "fleet_failed"


def until(condition: Callable[[], object], what: str, patience: float = _PATIENCE) -> None:
    """Wait for a condition. Raises Timeout, with `what` did not come to pass."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            raise Timeout(what)
        time.sleep(0.02)


def free_ports(count: int = 1) -> int:
    """The first of that many consecutive TCP ports that are free now, outside the range for outgoing connections."""
    for first in random.sample(range(20000, 32000, 16), 200):  # below Linux's ephemeral ports
        with contextlib.suppress(OSError), ExitStack() as stack:
            for port in range(first, first + count):
                stack.enter_context(socket.create_server(("127.0.0.1", port)))
            return int(first)
    raise FleetFailed(f"no {count} TCP ports in a row are free on this machine")


def started(words: bytes, *arguments: str) -> subprocess.Popen[bytes]:
    """A command of ours, once it has said these words. Raises FleetFailed."""
    process = subprocess.Popen(
        child.command("cm.cli.main", *arguments),
        stderr=subprocess.PIPE,
        env=child.environment(),
        start_new_session=True,  # Ctrl-C reaches it through us, in order
    )
    there, said = child.said_until(process, words, _PATIENCE)
    if not there:
        process.kill()
        process.communicate()
        raise FleetFailed(f"cm {' '.join(arguments[:2])} did not start: {said.decode(errors='replace')[-500:]}")
    threading.Thread(target=_drain, args=(process,), daemon=True).start()
    return process


def _drain(process: subprocess.Popen[bytes]) -> None:
    """Read what it says further, so that it never blocks on a full pipe."""
    assert process.stderr is not None
    with process.stderr as pipe, contextlib.suppress(OSError):
        while pipe.read(4096):
            pass


def ended(process: subprocess.Popen[bytes] | None, number: int = signal.SIGTERM) -> None:
    """End a process; none is fine. A simulated board may outlive its manager for a while."""
    if process is not None and not child.ended(process, number):
        raise Timeout(f"process {process.pid} did not end")


@contextlib.contextmanager
def local_etcd(folder: Path, options: Iterable[str] = ()) -> Iterator[str]:
    """One member of etcd on this machine; its URL. Raises FleetFailed."""
    port = free_ports(2)
    client, peer = f"http://127.0.0.1:{port}", f"http://127.0.0.1:{port + 1}"
    command = (
        "etcd", "--data-dir", str(folder), "--listen-client-urls", client, "--advertise-client-urls", client,
        "--listen-peer-urls", peer, "--initial-advertise-peer-urls", peer, "--initial-cluster", f"default={peer}",
        *options,
    )  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        end = time.monotonic() + _PATIENCE
        while not _listens(client):
            if time.monotonic() > end or process.poll() is not None:
                raise FleetFailed(f"etcd did not start: {' '.join(command)}")
            time.sleep(0.05)
        yield client
    finally:
        ended(process)


def _listens(url: str) -> bool:
    with contextlib.suppress(OSError):
        socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2])), timeout=1.0).close()
        return True
    return False


@dataclass
class BoardProcesses:
    """One board: `cm serve --sim` and `cm bridge fleet`."""

    name: str
    folder: Path
    router: str
    bridge_options: tuple[str, ...] = ()
    manager_options: tuple[str, ...] = ()
    manager: subprocess.Popen[bytes] | None = None
    bridge: subprocess.Popen[bytes] | None = None

    @property
    def runtime_dir(self) -> Path:
        """Where its manager's sockets lie."""
        return self.folder / "run"

    def start(self) -> BoardProcesses:
        """Both; again after `kill`, from what is on the disk."""
        self.folder.mkdir(exist_ok=True)
        settings = self.folder / "cm.yaml"
        settings.write_text(_SETTINGS, encoding="utf-8")
        run, state = str(self.runtime_dir), str(self.folder / "state")
        self.manager = started(
            b"ready at", "serve", "--sim", "--runtime-dir", run, "--state-dir", state, "--name", self.name,
            "--settings", str(settings), *self.manager_options,
        )  # fmt: skip
        self.bridge = started(
            b"ready as", "bridge", "fleet", "--runtime-dir", run, "--router", self.router,
            "--state-dir", str(self.folder / "fleet"), "--join", *self.bridge_options,
        )  # fmt: skip
        return self

    def kill(self) -> None:
        """Kill it as a loss of power would; the simulated hardware goes with its manager."""
        bridge, manager, self.bridge, self.manager = self.bridge, self.manager, None, None
        ended(bridge, signal.SIGKILL)
        ended(manager, signal.SIGKILL)

    def stop(self) -> None:
        """End both in order."""
        bridge, manager, self.bridge, self.manager = self.bridge, self.manager, None, None
        ended(bridge)
        ended(manager)


class LocalFleet:
    """A router and boards, as a context manager; the first board keeps the store, if it is not elsewhere."""

    def __init__(
        self, names: Iterable[str], folder: Path, at_once: int = 4, store: str = "", manager: tuple[str, ...] = ()
    ) -> None:
        """`manager`: further options of each board's manager."""
        self.router = f"tcp/127.0.0.1:{free_ports()}"
        self.store = store
        named = tuple(names)
        where = ("--store", store or "keeper")
        keeper = () if store else ("--keeper",)
        self.boards = {
            name: BoardProcesses(
                name, folder / name, self.router, where + (keeper if name == named[0] else ()), manager
            )
            for name in named
        }
        self._at_once = at_once
        self._stack = ExitStack()

    def __enter__(self) -> LocalFleet:
        try:
            self.router_process = started(b"ready", "fleet", "router", "--listen", self.router)
            self._stack.callback(ended, self.router_process)
            with ThreadPoolExecutor(self._at_once) as threads:
                for board in self.boards.values():
                    self._stack.callback(board.stop)
                list(threads.map(BoardProcesses.start, self.boards.values()))
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

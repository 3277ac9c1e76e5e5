# SPDX-License-Identifier: Apache-2.0
"""A manager that is not up yet behind forwarded ports: QEMU and `ssh -L` accept a connection and then close it."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path

import pytest
from manager_process import CAMERA, Manager, short_folder, until

import cm
import cm.aio
from cm.cli.main import main
from cm.simulation.software import Board as SimBoard
from cm.tools.demo.boards import free_ports

PATIENCE_S = 60
ENDED = 8  # handshakes, more than let a client suspect the manager's key


class Forwarder:
    """Accepts connections to a manager that is not up, and closes them, as long as it is open."""

    def __init__(self, port: int) -> None:
        self.ended = 0
        self._socket = socket.create_server(("127.0.0.1", port))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        with suppress(OSError):  # it was shut down
            while True:
                self._socket.accept()[0].close()
                self.ended += 1

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()


def blocking(address: str, keys: Path) -> list[str]:
    with cm.connect(address, keys=keys, timeout=PATIENCE_S) as board:
        return list(board.configs)


def asynchronous(address: str, keys: Path) -> list[str]:
    async def ask() -> list[str]:
        async with cm.aio.connect(address, keys=keys, timeout=PATIENCE_S) as board:
            return list(await board.configs())

    return asyncio.run(ask())


@pytest.fixture
def folder() -> Iterator[Path]:
    with short_folder() as made:
        yield made


@pytest.mark.parametrize("ask", [blocking, asynchronous])
def test_a_client_tries_until_the_manager_is_up(folder: Path, ask: Callable[[str, Path], list[str]]) -> None:
    assert main(["keygen", str(folder / "keys"), "laptop"]) == 0
    first = free_ports(3)
    listen = "--listen", f"tcp://127.0.0.1:{first}", "--keys", str(folder / "keys/server.key")
    with SimBoard([CAMERA], root=folder / "board") as sim, ThreadPoolExecutor(1) as pool:
        with closing(Forwarder(first + 2)) as forwarder:
            asked = pool.submit(ask, f"tcp://127.0.0.1:{first}", folder / "keys/laptop.key")
            until(lambda: forwarder.ended >= ENDED, PATIENCE_S)
            assert not asked.done()
        arguments = ("--config", str(CAMERA), "--root", str(sim.root), "--state-dir", str(folder / "state"))
        manager = Manager(folder / "run", *arguments, *listen).start()
        try:
            assert asked.result(PATIENCE_S) == ["camera"]
        finally:
            manager.stop()

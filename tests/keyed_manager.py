# SPDX-License-Identifier: Apache-2.0
"""A manager on ipc and on TCP with keys, as processes of their own, with the camera example loaded."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from manager_process import Manager, served, short_folder

from cm.cli.main import main


@dataclass(frozen=True, slots=True)
class KeyedManager:
    """The manager, and the key file of a client that it admits over TCP."""

    manager: Manager
    keys: Path

    @property
    def pid(self) -> int:
        return self.manager.pid


@contextlib.contextmanager
def served_with_keys() -> Iterator[KeyedManager]:
    """Serve it with new keys on a free port."""
    with short_folder() as folder:
        assert main(["keygen", str(folder), "me"]) == 0
        arguments = ("--listen", "tcp://127.0.0.1:0", "--keys", str(folder / "server.key"))
        with served(arguments=arguments) as (manager, _):
            with manager.connected() as board:
                board.load("camera", "default")
            yield KeyedManager(manager, folder / "me.key")

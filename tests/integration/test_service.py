# SPDX-License-Identifier: Apache-2.0
"""`cm serve` under a service manager: notifications, signals, settings."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import CAMERA, Manager, environment, short_folder

import cm
from cm.errors import CmError
from cm.simulation.software import Board as SimBoard
from cm.tools.demo.boards import free_ports

SCHEMA = "config: {{name: {}, modules: {{a: {{}}}}, modes: {{m: {{modules: [a]}}}}}}\n"


class Service:
    """A manager whose service manager is the test."""

    def __init__(self, folder: Path, board: Path, watchdog_ms: int) -> None:
        self.folder, self.board = folder, board
        self.configs = folder / "configs"
        self.port = free_ports(3)
        self.keys = folder / "keys"
        shutil.copytree(CAMERA, self.configs)
        self.inbox = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.inbox.bind(str(folder / "notify"))
        self.inbox.settimeout(60)
        self.keygen("first")
        settings = folder / "cm.yaml"
        settings.write_text(
            f"listen: ['tcp://127.0.0.1:{self.port}']\nkeys: {self.keys}/server.key\nconfigs: ['{self.configs}']\n"
            f"state_dir: {folder}/state\nlog: info\n"
        )
        env = {
            **environment(),
            "NOTIFY_SOCKET": str(folder / "notify"),
            "WATCHDOG_USEC": str(watchdog_ms * 1000),
        }
        arguments = ("--settings", str(settings), "--root", str(board))
        self.manager = Manager(folder / "run", *arguments, env=env, service=True)

    def keygen(self, client: str) -> None:
        command = [sys.executable, "-m", "cm.cli.main", "keygen", str(self.keys), client]
        subprocess.run(command, env=environment(), check=True, capture_output=True)

    def told(self, wanted: bytes) -> bytes:
        """The next message with this beginning; keepalives in between are skipped."""
        while True:
            message = self.inbox.recv(4096)
            if message.startswith(wanted):
                return message
            assert message == b"WATCHDOG=1", message

    def signal(self, number: int) -> None:
        assert self.manager.process is not None
        os.kill(self.manager.process.pid, number)

    def reload(self) -> None:
        self.signal(signal.SIGHUP)
        self.reloaded()

    def reloaded(self) -> None:
        self.told(b"RELOADING=1\nMONOTONIC_USEC=")
        self.told(b"READY=1")

    def answers(self, client: str, timeout: float) -> bool:
        """Whether the manager answers this client over TCP."""
        try:
            with cm.connect(f"tcp://127.0.0.1:{self.port}", keys=self.keys / f"{client}.key", timeout=timeout) as board:
                return bool(board.configs)
        except CmError:
            return False


@pytest.fixture
def service() -> Iterator[Service]:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board") as sim:
        service = Service(folder, sim.root, watchdog_ms=200)
        service.manager.start()
        service.told(b"READY=1")
        yield service
        service.manager.stop()

        service.inbox.close()


def test_a_reload_takes_new_schemas_and_leaves_what_runs_and_what_is_damaged(service: Service) -> None:
    assert service.told(b"WATCHDOG=1")
    with service.manager.connected() as board:
        board.load("camera", mode="default")
        sequence = board.status.last_change
        (service.configs / "vision.yaml").write_text(SCHEMA.format("vision"))
        service.reload()
        assert set(board.configs) == {"camera", "vision"}
        (service.configs / "vision.yaml").unlink()
        service.reload()
        assert set(board.configs) == {"camera"}
        assert (board.status.config_name, board.status.mode) == ("camera", "default")
        assert board.status.last_change == sequence
        (service.configs / "bad.yaml").write_text("config: {name: [\n")
        (service.folder / "cm.yaml").write_text("listen: 3\n")
        service.reload()
        assert set(board.configs) == {"camera"}
    assert service.manager.stop() == 0
    service.told(b"STOPPING=1")


def test_keys_count_and_end_once_they_are_changed_without_a_signal(service: Service) -> None:
    assert service.answers("first", timeout=60)
    service.keygen("second")
    service.reloaded()
    assert service.answers("second", timeout=60)
    (service.keys / "authorized_keys.d/first.pub").unlink()
    service.reloaded()
    assert not service.answers("first", timeout=60)

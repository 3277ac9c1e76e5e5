# SPDX-License-Identifier: Apache-2.0
"""A client that keeps connecting to the data socket beside another, and what is left to the collector of garbage."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_thread import Daemon, daemon
from flood import running
from manager_process import CAMERA, environment, until

from cm.wire.plane_packets import Open, encode_open

pytestmark = pytest.mark.soak
# Opens many connections to the data socket, says nothing, and reports when all but a few have been closed.
CONNECTS = """
import socket, sys
made = []
for _ in range(int(sys.argv[2])):
    made.append(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
    made[-1].connect(sys.argv[1])
for one in made[: -int(sys.argv[3])]:
    assert one.recv(1) == b""
print("hung up", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def served() -> Iterator[Daemon]:
    with daemon() as made:
        yield made


def test_a_client_that_keeps_connecting_to_the_data_socket_displaces_nobody(served: Daemon) -> None:
    path = served.folder / "run" / "data"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as ours:
        ours.settimeout(60)
        ours.connect(str(path))
        with running("-c", CONNECTS, path, 400, 48, first="hung up"):
            until(lambda: len(served.server._data_socket._awaiting) == 49)
            ours.send(encode_open(Open("", echo=True, length=4096, depth=1)))
            assert ours.recv(4096)


def test_what_a_manager_has_made_when_it_is_ready_is_never_looked_through_for_garbage(tmp_path: Path) -> None:
    """Full collections took 15 to 30 ms of its loop, the first of them when the first flood came."""
    code = (
        "import gc, sys\nfrom cm.server.server import Server\nfrom cm.cli.main import main\n"
        "Server.serve = lambda self, ready: (ready(), self._close())\n"
        "status = main(sys.argv[1:])\n"
        "print(status, gc.get_freeze_count() > 20_000, len(gc.get_objects()) < 5_000)"
    )
    words = ["serve", "--config", str(CAMERA), "--runtime-dir", str(tmp_path / "r"), "--state-dir", str(tmp_path / "s")]
    said = subprocess.run(
        [sys.executable, "-c", code, *words], env=environment(), capture_output=True, text=True, timeout=60, check=True
    )
    assert said.stdout == "0 True True\n"

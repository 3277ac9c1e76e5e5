# SPDX-License-Identifier: Apache-2.0
"""The board with the manager listening, and tests on the host that talk to it over TCP."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vmboard import qemu, report
from vmboard.errors import VmError
from vmboard.paths import REPOSITORY

TESTS = REPOSITORY / "tests/vm/remote"
BOOT_S = 50.0  # until the manager answers, times the board's slowness
PATIENCE_S = 10  # for one step, as on the board


def free_ports(lane: int, count: int = 3) -> int:
    """The first of so many neighbouring ports that nobody has now.

    Boards bind theirs minutes later: each looks in one of ten lanes, so that no two of a run get the same ones.
    """
    lowest = 20000 + 1200 * lane
    for first in random.sample(range(lowest, lowest + 1200, 16), 64):  # other runs look for some at the same time
        if all(_free(first + index) for index in range(count)):
            return first
    raise VmError(f"no {count} neighbouring TCP ports are free on this host")


def _free(port: int) -> bool:
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


@contextmanager
def served(board: qemu.Machine, place: Path) -> Iterator[None]:
    """Boot and wait until the manager says that it is ready; the board is switched off at the end."""
    arguments = qemu.logged(board, place)
    with (place / "qemu.log").open("wb") as log:
        process = subprocess.Popen(arguments, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    try:
        _wait(process, place / "output.log", time.monotonic() + BOOT_S * board.slow)
        yield
    finally:
        process.kill()
        process.wait()


def _wait(process: subprocess.Popen[bytes], output: Path, deadline: float) -> None:
    while b"ready at" not in (text := output.read_bytes() if output.exists() else b""):
        if process.poll() is not None or time.monotonic() > deadline:
            raise VmError(f"the manager on the board did not start: {text.decode(errors='replace')}")
        time.sleep(0.2)


def test(board: qemu.Machine, place: Path, port: int) -> report.Results:
    """Run the tests in tests/vm/remote against the board."""
    with served(board, place):
        endpoint, patience = f"tcp://127.0.0.1:{port}", str(PATIENCE_S * board.slow)
        own = {"CM_VM_ENDPOINT": endpoint, "CM_TEST_PATIENCE": patience, "PYTHONPATH": str(REPOSITORY)}
        environment = {**os.environ, **own}
        xml = place / "remote.xml"
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junit-xml={xml}", str(TESTS)]
        with (place / "pytest.log").open("wb") as log:
            status = subprocess.run(command, env=environment, cwd=REPOSITORY, stdout=log, stderr=log, check=False)
    return report.of_host(xml, place / "console.log", status.returncode)

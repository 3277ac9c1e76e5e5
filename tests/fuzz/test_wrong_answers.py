# SPDX-License-Identifier: Apache-2.0
"""Each client beside a manager that answers wrongly: it says so in its time, grows by nothing, and is of use after it.

Clients in other languages are tried by their own suites, which name their driver: `CM_DRIVER="build/go/driver"`.
"""

from __future__ import annotations

import asyncio
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import cm.aio
from cm.client.board import Board
from cm.errors import CmError
from cm.tools.conformance.runner import Driver

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
from fake_manager import CONNECTING, FRAMES, MIB, PACKETS, REPLIES, VALUE, FakeManager  # noqa: E402

DRIVER = shlex.split(os.environ.get("CM_DRIVER", "")) or [sys.executable, "-m", "cm.tools.conformance.driver"]
LIMIT = 0.5  # seconds that a client waits for an answer
CONNECT = 12  # seconds that a client may take to find that there is no connection to be had
BUSY = 20  # seconds that a busy machine may take on top
GROWTH = 64 * MIB
DO = [
    {"do": "status"},
    {"do": "status"},
    {"do": "read", "names": ["v"]},
    {"do": "frame", "stream": "camera"},
    {"do": "frames", "stream": "camera", "count": 1},
    {"do": "statuses", "count": 1},
]
SAID = [*CONNECTING, *REPLIES, *FRAMES, "hangs up"]


@pytest.fixture
def fake(request: pytest.FixtureRequest) -> Iterator[FakeManager]:
    """Its folder's name is short, for sockets."""
    data = getattr(request, "param", False)
    with tempfile.TemporaryDirectory(prefix="cm-f-") as folder, FakeManager(Path(folder), data).serving() as manager:
        yield manager


data_socket = pytest.mark.parametrize("fake", [True], indirect=True, ids=["data"])


@pytest.fixture(scope="module")
def drivers() -> Iterator[list[Driver]]:
    made: list[Driver] = []
    yield made
    for each in made:
        each.close()


@pytest.fixture
def driver(drivers: list[Driver]) -> Driver:
    """One process for all cases, while it lives: what one of them left behind shows in the next."""
    if not drivers or drivers[-1].ended:
        drivers.append(Driver(DRIVER))
    return drivers[-1]


def resident(pid: int) -> int:
    """Bytes of a process in memory."""
    text = Path(f"/proc/{pid}/status").read_text()
    return int(text.partition("VmRSS:")[2].split()[0]) << 10


def asked(driver: Driver, fake: FakeManager, case: str) -> list[dict[str, Any]]:
    fake.case = case
    line = {"case": case, "connect": {"folder": str(fake.folder)}, "timeout": LIMIT, "do": DO}
    return driver.ask(line, CONNECT * len(DO) + BUSY)


def check_good(driver: Driver, fake: FakeManager) -> None:
    results = asked(driver, fake, "")
    assert [r.get("mode") for r in results[:2]] == ["good", "good"]
    assert (int(results[2]["values"]["v"]), results[3]["data"]) == (VALUE, [97, 98, 99, 100])
    assert (results[4]["sequences"], results[5]["modes"]) == ([1], ["good"])


@pytest.mark.parametrize("case", SAID)
def test_a_client_lives_through_an_answer_that_is_wrong(driver: Driver, fake: FakeManager, case: str) -> None:
    check_good(driver, fake)
    before, begun = resident(driver.pid), time.monotonic()
    results = asked(driver, fake, case)
    took = time.monotonic() - begun
    assert len(results) == len(DO)
    assert took < CONNECT + BUSY, results
    for result in results:
        assert isinstance(result.get("error", ""), str)
        assert result, "neither a result nor an error"
    check_good(driver, fake)
    assert resident(driver.pid) - before < GROWTH


@pytest.mark.parametrize("case", [*CONNECTING, *REPLIES, "hangs up"])
def test_the_asyncio_client_lives_through_an_answer_that_is_wrong(fake: FakeManager, case: str) -> None:
    async def course() -> None:
        board = cm.aio.Board(str(fake.folder), timeout=LIMIT)
        for ask in (
            board.status,
            lambda: board.registers.read("v"),
            lambda: board.stream("camera", LIMIT, copy=True).read(),
        ):
            with suppress(CmError, ConnectionError):
                await asyncio.wait_for(ask(), CONNECT + BUSY)
        await board.close()

    fake.case = case
    asyncio.run(course())


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 (as fast as can be)


@data_socket
@pytest.mark.parametrize("case", PACKETS)
def test_what_comes_on_the_data_socket_is_an_error_or_nothing(fake: FakeManager, case: str) -> None:
    fake.case = case
    with Board(str(fake.folder), timeout=LIMIT) as board:
        uses: tuple[Callable[[], object], ...] = (
            lambda: board.stream("camera", LIMIT).read(),
            lambda: board.writer("camera", LIMIT).flush(),
            lambda: board.registers.window("edge"),
            lambda: board.allocate(16),
        )
        for use in uses:
            before = descriptors()
            for _ in range(2):
                with suppress(CmError):
                    use()
            assert descriptors() - before < 40, "what comes and is not used is closed"


@data_socket
@pytest.mark.programs
@pytest.mark.skipif(shutil.which("cc") is None, reason="needs_cc: not installed")
def test_the_c_client_lives_through_each_packet_that_is_wrong(fake: FakeManager, tmp_path: Path) -> None:
    program, source = tmp_path / "wrong", HERE.parents[1] / "csrc"
    client = sorted((source / "client").glob("*.c"))
    shims = [
        source / f"{name}.c" for name in ("window", "mirror", "node", "event", "message", "path", "request", "bus")
    ]
    flags = ["-std=gnu11", "-D_GNU_SOURCE", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    include = [f"-I{source}", f"-I{source.parent}/kmod/uapi"]
    subprocess.run(
        ["cc", *flags, *include, "-o", program, HERE / "wrong_packets.c", *client, *shims, "-lpthread"], check=True
    )
    for case in PACKETS:
        fake.case = case
        done = subprocess.run(
            [program, fake.folder], capture_output=True, text=True, timeout=CONNECT + BUSY, check=False
        )
        assert done.returncode == 0, f"{case}: {done.stderr}"

# SPDX-License-Identifier: Apache-2.0
"""Uploads in parts, and how the room for them is shared."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from cm.server import uploads
from cm.server.rights.principal import NOBODY
from cm.server.shares.budget import Bounds, Budget
from cm.server.shares.registry import Budgets
from cm.server.shares.turns import Account, VirtualTime
from cm.server.uploads import TooMuchUploaded, Uploads
from cm.wire.messages.requests import Upload

CLOCK = VirtualTime()
ALL = Budgets(Bounds(0, 0), lambda _: NOBODY, lambda *_: None, lambda: ())
ANNA, BEN = Account("uid:1", CLOCK), Account("uid:2", CLOCK)


class Now:
    """The time, which a test sets."""

    def __init__(self) -> None:
        self.seconds = 1000.0

    def monotonic(self) -> float:
        return self.seconds


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> Now:
    made = Now()
    monkeypatch.setattr(uploads, "time", made)
    return made


@pytest.fixture
def clients() -> list[Budget]:
    return []


@pytest.fixture
def kept(tmp_path: Path, clients: list[Budget]) -> Iterator[Uploads]:
    made = Uploads(tmp_path, 256, 512, lambda: sum(client.upload_bytes for client in clients))
    yield made
    made.close()


def client(name: str, account: Account, clients: list[Budget]) -> Budget:
    made = Budget(name, Bounds(0, 0), ALL, account)
    made.place, made.connections = name, 1
    clients.append(made)
    return made


def test_processes_of_one_account_leave_a_quarter_of_the_room_to_other_accounts(
    kept: Uploads, clients: list[Budget]
) -> None:
    first, second, third = (client(f"pid {i}", ANNA, clients) for i in (1, 2, 3))
    kept.take(first, Upload("a", 256))
    kept.take(second, Upload("a", 128))
    with pytest.raises(TooMuchUploaded, match="0 bytes of pid 3 are stored here unused, 384 of uid:1, 384 of all"):
        kept.take(third, Upload("a", 1))
    kept.take(client("key laptop", BEN, clients), Upload("a", 128))


def test_uploads_of_a_process_that_is_gone_soon_make_room(kept: Uploads, now: Now, clients: list[Budget]) -> None:
    gone, stays, elsewhere = (client(name, ANNA, clients) for name in ("pid 1", "pid 2", "192.0.2.1"))
    for one in clients:
        kept.take(one, Upload("a", 100))
    gone.connections = elsewhere.connections = 0
    now.seconds += uploads.LEFT - 1
    kept.forget_old()
    assert [one.upload_bytes for one in clients] == [100, 100, 100]
    now.seconds += 2
    kept.forget_old()
    assert [one.upload_bytes for one in clients] == [0, 100, 100]  # one client elsewhere may reconnect
    now.seconds += uploads.IDLE
    kept.forget_old()
    assert [one.upload_bytes for one in clients] == [0, 0, 0]
    assert stays.connections == 1

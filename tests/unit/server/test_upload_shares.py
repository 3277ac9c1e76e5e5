# SPDX-License-Identifier: Apache-2.0
"""Uploads in parts, and how the room for them is shared."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from cm.server import uploads
from cm.server.rights.principal import Principal, from_id
from cm.server.settings.model import USUAL
from cm.server.shares import Client, Clients
from cm.server.uploads import TooMuchUploaded, Uploads
from cm.wire.messages.requests import Upload

GONE = 1 << 22  # no process has this number
LIMITS = replace(USUAL, upload_bytes=256, uploads_bytes=512)


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
def clients() -> Clients:
    return Clients(LIMITS, lambda name: from_id(name) if ":" in name else Principal(name, "tcp", address=name))


@pytest.fixture
def kept(tmp_path: Path, clients: Clients) -> Iterator[Uploads]:
    made = Uploads(tmp_path, LIMITS, clients.upload_bytes)
    yield made
    made.close()


def process(clients: Clients, pid: int) -> Client:
    return clients.of(f"ipc:0:0:{pid}")


def test_no_client_gets_more_room_than_one_may_nor_all_more_than_there_is(kept: Uploads, clients: Clients) -> None:
    one, two, three = (process(clients, GONE + i) for i in range(3))
    kept.take(one, Upload("a", 256))
    said = r"256 bytes of pid .* are stored here unused, 256 of all; 1 more are too many \(limits.upload_mib, "
    with pytest.raises(TooMuchUploaded, match=said):
        kept.take(one, Upload("b", 1))
    kept.take(two, Upload("a", 200))
    with pytest.raises(TooMuchUploaded, match=r"0 bytes of pid .* are stored here unused, 456 of all; 57 more"):
        kept.take(three, Upload("a", 57))
    kept.take(three, Upload("a", 56))


def test_uploads_of_a_process_that_is_gone_soon_make_room(kept: Uploads, now: Now, clients: Clients) -> None:
    gone, stays, elsewhere = process(clients, GONE), process(clients, os.getpid()), clients.of("192.0.2.1")
    for one in clients:
        kept.take(one, Upload("a", 100))
    now.seconds += uploads.LEFT - 1
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [100, 100, 100]
    now.seconds += 2
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [0, 100, 100]  # one elsewhere may reconnect
    now.seconds += uploads.IDLE
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [0, 0, 0]

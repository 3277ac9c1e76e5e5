# SPDX-License-Identifier: Apache-2.0
"""Uploads in parts, and how the room for them is shared."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cm.errors import InvalidRequest
from cm.server import uploads
from cm.server.client_quotas import Client, Clients
from cm.server.requests import BY_KIND
from cm.server.rights.principal import Principal, from_id
from cm.server.sender_order import Asked
from cm.server.settings.model import USUAL
from cm.server.uploads import EACH, TooMuchUploaded, UnknownUpload, UploadFailed, Uploads
from cm.wire.messages.requests import File, Provision, Upload, WriteData
from cm.wire.messages.status import ErrorInfo, Reply, UploadInfo

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


def test_processes_of_one_user_share_what_it_may_store(kept: Uploads, clients: Clients) -> None:
    kept.take(process(clients, GONE), Upload("a", 255, data=bytes(255)))
    with pytest.raises(TooMuchUploaded, match="255 bytes of uid:0 are stored here unused"):
        kept.take(process(clients, GONE + 1), Upload("b", 2, data=bytes(2)))


def test_what_is_only_said_to_come_takes_no_room_of_others(kept: Uploads, clients: Clients) -> None:
    for number in range(4):
        kept.take(process(clients, GONE + number), Upload("a", 256, data=b"1"))
    kept.take(process(clients, GONE), Upload("b", 252, data=bytes(252)))
    with pytest.raises(TooMuchUploaded, match="256 bytes of uid:0 are stored here unused"):
        kept.take(process(clients, GONE), Upload("a", 256, offset=1, data=b"2"))
    kept.take(process(clients, GONE), Upload("b", discard=True))
    assert kept.take(process(clients, GONE), Upload("a", 256, offset=1, data=b"2")).offset == 2
    with pytest.raises(TooMuchUploaded, match="257 more are too many"):
        kept.take(process(clients, GONE), Upload("c", 257, data=b"1"))


def test_no_client_gets_more_room_than_one_may_nor_all_more_than_there_is(kept: Uploads, clients: Clients) -> None:
    one, two, three = (clients.of(f"ipc:{i}:0:{GONE + i}") for i in range(3))
    kept.take(one, Upload("a", 256, data=bytes(256)))
    said = r"256 bytes of uid:0 .*, 256 of all; 1 more are too many \(limits.uploads_mib: half of it for each user\)$"
    with pytest.raises(TooMuchUploaded, match=said):
        kept.take(one, Upload("b", 1, data=b"1"))
    kept.take(two, Upload("a", 200, data=bytes(200)))
    with pytest.raises(
        TooMuchUploaded, match=r"0 bytes of uid:2 are stored here unused, 456 of all; 57 more are too many"
    ):
        kept.take(three, Upload("a", 57, data=bytes(57)))
    kept.take(three, Upload("a", 56, data=bytes(56)))


def test_uploads_of_a_process_that_is_gone_soon_make_room(kept: Uploads, now: Now, clients: Clients) -> None:
    gone, stays, elsewhere = process(clients, GONE), process(clients, os.getpid()), clients.of("192.0.2.1")
    for one in clients:
        kept.take(one, Upload("a", 100, data=bytes(100)))
    now.seconds += uploads.LEFT - 1
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [100, 100, 100]
    now.seconds += 2
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [0, 100, 100]  # one elsewhere may reconnect
    now.seconds += uploads.IDLE
    kept.forget_old()
    assert [one.upload_bytes for one in (gone, stays, elsewhere)] == [0, 0, 0]


@pytest.fixture
def one(clients: Clients) -> Client:
    return process(clients, os.getpid())


def parts(kept: Uploads, client: Client, name: str, *sent: bytes, length: int | None = None) -> UploadInfo:
    """Send these parts of an upload, which is complete with them if no length is given."""
    told, length = UploadInfo(name, 0, 0), sum(map(len, sent)) if length is None else length
    for number, part in enumerate(sent):
        told = kept.take(client, Upload(name, length, offset=sum(map(len, sent[:number])), data=part))
    return told


def test_parts_follow_each_other_within_the_length_that_was_said(kept: Uploads, one: Client, clients: Clients) -> None:
    other = process(clients, GONE)
    assert parts(kept, one, "a", b"12", b"345", length=6) == UploadInfo("a", 6, 5)
    for part, said in (
        (Upload("a", 6, offset=4, data=b"5"), "upload 'a': byte 4 of 6 where 5 of 6 is next"),
        (Upload("a", 7, offset=5, data=b"6"), "upload 'a': byte 5 of 7 where 5 of 6 is next"),
        (Upload("a", 6, offset=5, data=b"67"), "upload 'a': 2 bytes at 5 of 6"),
    ):
        with pytest.raises(InvalidRequest, match=f"^{said}$"):
            kept.take(one, part)
    for client, name, offset in ((one, "b", 5), (other, "a", 5)):
        with pytest.raises(UnknownUpload, match=f"upload '{name}': there are no bytes before 5; begin with offset 0"):
            kept.take(client, Upload(name, 6, offset=offset, data=b"6"))
    assert (one.upload_bytes, other.upload_bytes) == (5, 0)
    assert kept.take(one, Upload("a", 6, offset=5, data=b"6")) == UploadInfo("a", 6, 6)
    assert kept.take(one, Upload("a", 6, discard=True)) == UploadInfo("a", 6, 0)
    assert one.upload_bytes == 0


def asks(one: Client, request: Any, said: list[Reply]) -> Asked:
    """A request on its way."""
    order: Any = None
    return Asked(BY_KIND[type(request)], request, "", b"", one, one, order, said.append)


def test_a_request_is_filled_in_and_uses_up_what_it_took_once_it_is_accepted(kept: Uploads, one: Client) -> None:
    said: list[Reply] = []
    parts(kept, one, "a", b"12", b"3")
    parts(kept, one, "b", b"")
    files = File("x", b"").uploaded("a"), File("y", b"own"), File("z", b"").uploaded("b")
    for reply in (Reply(error=ErrorInfo("busy", "not now")), Reply()):
        asked = asks(one, Provision("config: {}", files), said)
        kept.fill_in(asked)
        filled = asked.request
        assert isinstance(filled, Provision)
        assert [(f.name, bytes(f.data), f.upload) for f in filled.files] == [
            ("x", b"123", ""),
            ("y", b"own", ""),
            ("z", b"", ""),
        ]
        assert one.upload_bytes == 3
        asked.answer(reply)
        assert said[-1] is reply
    assert one.upload_bytes == 0
    parts(kept, one, "c", b"1", length=2)
    for name, why in (("a", "there is no upload of that name"), ("c", "1 of 2 bytes are there")):
        with pytest.raises(UnknownUpload, match=f"upload '{name}': {why}"):
            kept.fill_in(asks(one, WriteData("s", upload=name), said))
    kept.take(one, Upload("c", 2, offset=1, data=b"2"))
    asked = asks(one, WriteData("s", upload="c", lease="l"), said)
    kept.fill_in(asked)
    filled = asked.request
    assert isinstance(filled, WriteData)
    assert (filled.stream, bytes(filled.data), filled.upload, filled.lease) == ("s", b"12", "", "l")
    asked.answer(Reply())
    assert one.upload_bytes == 0
    for own in (WriteData("s", b"1"), Provision("config: {}", files[1:2])):
        asked = asks(one, own, said)
        kept.fill_in(asked)
        assert asked.request is own


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def used(kept: Uploads, one: Client) -> None:
    parts(kept, one, "a", b"123")
    kept.fill_in(asks(one, WriteData("s", upload="a"), []))


@pytest.mark.parametrize(("call", "left"), [("pwrite", 0), ("truncate", 0), ("mmap", 3)])
def test_a_full_disk_is_told_and_leaves_nothing_that_counts(
    kept: Uploads, one: Client, monkeypatch: pytest.MonkeyPatch, call: str, left: int
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    before = descriptors()
    monkeypatch.setattr(uploads.mmap if call == "mmap" else os, call, full)
    with pytest.raises(UploadFailed, match=r"upload 'a'( in .*)?: No space left on device"):
        used(kept, one)
    monkeypatch.undo()
    assert one.upload_bytes == left
    kept.close()
    assert (one.upload_bytes, descriptors()) == (0, before)


def test_what_the_kernel_takes_in_pieces_is_written_whole(
    kept: Uploads, one: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda fd, data, at: write(fd, bytes(data)[:2], at))
    parts(kept, one, "a", b"12345", b"678")
    asked = asks(one, WriteData("s", upload="a"), [])
    kept.fill_in(asked)
    assert bytes(asked.request.data) == b"12345678"


def test_each_client_has_so_many_uploads(kept: Uploads, one: Client, clients: Clients) -> None:
    for number in range(EACH):
        kept.take(one, Upload(str(number), 0))
    with pytest.raises(TooMuchUploaded, match=f"{EACH} uploads of uid:0 are stored here unused"):
        kept.take(process(clients, GONE), Upload("more", 0))
    kept.take(clients.of(f"ipc:1:0:{GONE + 1}"), Upload("more", 0))
    kept.take(one, Upload("0", discard=True))
    kept.take(one, Upload("more", 0))
    kept.limits = replace(LIMITS, upload_bytes=8, uploads_bytes=9)
    kept.take(one, Upload("1", 0, discard=True))
    with pytest.raises(TooMuchUploaded):
        kept.take(one, Upload("1", 9))
    kept.take(one, Upload("1", 8))

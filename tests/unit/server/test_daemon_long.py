# SPDX-License-Identifier: Apache-2.0
"""Requests that are too long for one turn: uploads in parts, many registers at once, memory for the PL."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
from collections.abc import Iterator
from dataclasses import replace

import pytest
from daemon_thread import Daemon, Subscriber, daemon
from data_client import Client
from manager_process import until

from cm.device import DeviceNotFound, Icap
from cm.manager.manager import Settings
from cm.server.settings.model import USUAL
from cm.wire import plane_packets as packets
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ChangeMode, ConfigureStream, File, ReadReg, RegWrite, Upload, WriteReg
from cm.wire.messages.status import RegValues, UploadInfo
from cm.wire.plane_packets import Open, Purpose

FRAME = 48 * 64
PICTURE = bytes(index % 251 for index in range(FRAME))
MOST = 400_000  # bytes in parts that one client may have here; an image of the camera example has 266 KiB
PAGE = os.sysconf("SC_PAGE_SIZE")
MANY = 40  # registers of a request that is done piece by piece


@pytest.fixture(scope="module")
def shared() -> Iterator[Daemon]:
    limits = replace(
        USUAL, upload_bytes=MOST, uploads_bytes=2 * MOST, memory_bytes=16 * PAGE, memory_each_bytes=8 * PAGE
    )
    with daemon(limits=limits, settings=Settings(prefetch_bytes=0)) as made:
        yield made


@pytest.fixture
def camera(shared: Daemon) -> Daemon:
    """A daemon in the camera's default mode, freshly loaded."""
    shared.done(ChangeMode("camera", "default", force=True))
    return shared


@pytest.fixture
def flowing(shared: Daemon) -> Iterator[Daemon]:
    """A daemon that loops small frames from `to_pl` back to `from_pl`, which is kept open."""
    shared.load("loopback")
    for name in ("to_pl", "from_pl"):
        shared.done(ConfigureStream(name, shape=(48, 64), force=True))
    shared.done(ConfigureStream("from_pl", enable=True))
    yield shared
    shared.done(ConfigureStream("from_pl", automatic=True))


def uploaded(daemon: Daemon) -> int:
    """Bytes of clients' incomplete uploads, by the status."""
    return sum(client.upload_bytes for client in daemon.done(rq.ReadStatus(clients=True)).clients)


# ---- uploads in parts -------------------------------------------------------------------------


def test_a_frame_sent_in_parts_is_written_once(flowing: Daemon) -> None:
    assert flowing.done(Upload("a", FRAME, offset=0, data=PICTURE[:1000])) == UploadInfo("a", FRAME, 1000)
    assert flowing.done(Upload("a", FRAME, offset=1000, data=PICTURE[1000:])) == UploadInfo("a", FRAME, FRAME)
    assert uploaded(flowing) == FRAME
    flowing.send(rq.ReadData("from_pl", 60.0))
    flowing.send(rq.WriteData("to_pl", upload="a"))
    payloads = [reply.payload for reply in (flowing.reply(), flowing.reply()) if reply.payload]
    assert [bytes(payload[0]) for payload in payloads] == [PICTURE]
    assert uploaded(flowing) == 0
    code, message = flowing.refused(rq.WriteData("to_pl", upload="a"))
    assert (code, "there is no upload of that name" in message) == ("unknown_upload", True)


SENT = """
config:
  name: sent
  device: xc7z020
  regions: {prr0: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}}}
  modules: {default: {region: prr0, bitstream: given.bit}}
  modes: {only: {modules: [default]}}
"""


def send_config(daemon: Daemon) -> bytes:
    """Send a configuration whose image was uploaded before; return the image."""
    image: bytes = (daemon.board.root / "lib/firmware/cm/camera/default.bit").read_bytes()
    daemon.done(Upload("image", len(image), offset=0, data=image))
    file = File("given.bit", image).uploaded("image")
    assert (file.data, file.sha256) == (b"", hashlib.sha256(image).hexdigest())
    assert daemon.refused(rq.Provision("config: [", (file,)))[0] == "schema_invalid"  # the upload is still there
    daemon.done(rq.Provision(SENT, (file,)))
    assert daemon.refused(rq.Provision(SENT, (file,)))[0] == "unknown_upload"
    return image


def test_a_configuration_uses_files_uploaded_before_and_can_be_removed(camera: Daemon) -> None:
    image = send_config(camera)
    (stored,) = (camera.folder / "state").rglob("given.bit")
    assert stored.read_bytes() == image
    assert uploaded(camera) == 0
    assert "sent" in camera.done(rq.ListConfigs()).names
    listed = camera.done(rq.RemoveConfig("sent"))
    assert "sent" not in listed.names
    assert "sent" not in camera.done(rq.ListConfigs()).names
    assert not list((camera.folder / "state").rglob("given.bit"))
    assert camera.refused(ChangeMode("sent", "only"))[0] == "unknown_config"


def test_a_configuration_that_is_loaded_or_leased_is_not_removed(camera: Daemon) -> None:
    send_config(camera)
    camera.done(ChangeMode("sent", "only"))
    code, message = camera.refused(rq.RemoveConfig("sent"))
    assert (code, "load another first" in message) == ("busy", True)
    camera.load("default")
    lease = camera.done(rq.TakeLease("config", holder="me"))
    assert camera.refused(rq.RemoveConfig("sent"))[0] == "held_by"
    assert "sent" in camera.done(rq.ListConfigs()).names
    camera.done(rq.RemoveConfig("sent", lease=lease.id))
    camera.done(rq.ReleaseLease(lease.id))


# ---- many registers ----------------------------------------------------------------------------


def values(told: RegValues) -> list[int]:
    return [value.value for value in told.values]


def test_many_writes_take_effect_in_their_order_and_are_published(camera: Daemon) -> None:
    seen = Subscriber(camera, b"cm_read_reg")
    done = camera.done(WriteReg(tuple(RegWrite("focus", number % 16) for number in range(MANY))))
    assert values(done) == [number % 16 for number in range(MANY)]
    told = seen.until(RegValues)
    assert values(told)[-1] == (MANY - 1) % 16
    assert values(camera.done(ReadReg(("focus",)))) == [(MANY - 1) % 16]
    seen.close()


def test_a_write_that_is_long_to_read_keeps_its_place_among_the_senders_requests(camera: Daemon) -> None:
    def sent(last: str) -> int:
        """A message of more than may be read at once, behind which others wait; the length of the request."""
        writes = (*(RegWrite("focus", number % 16) for number in range(300)), RegWrite("focus", 7), RegWrite(last, 5))
        for request in (WriteReg(writes), ReadReg(("focus",)), WriteReg((RegWrite("focus", 9),))):
            camera.send(request)
        return len(writes)

    count = sent("led")
    written, read, after = (camera.reply().body for _ in range(3))
    assert isinstance(written, RegValues)
    assert isinstance(read, RegValues)
    assert (len(written.values), values(read), values(after)) == (count, [7], [9])  # type: ignore[arg-type]
    sent("x" * 300)  # no register's name is as long
    refused, read, after = (camera.reply() for _ in range(3))
    assert refused.error is not None
    assert refused.error.code == "name_too_long"
    assert isinstance(read.body, RegValues)
    assert (values(read.body), after.error) == ([9], None)
    assert values(camera.done(ReadReg(("focus", "led")))) == [9, 5]


# ---- memory for masters in the PL --------------------------------------------------------------


def allocated(daemon: Daemon, length: int) -> contextlib.closing[Client]:
    return contextlib.closing(Client(daemon, Open("", Purpose.ALLOCATE, length=length)))


def memory_used(daemon: Daemon) -> int:
    return int(daemon.board.control.state()["memory"])


def test_memory_has_an_address_and_is_freed_with_its_client(camera: Daemon) -> None:
    until(lambda: memory_used(camera) == 0)
    with allocated(camera, PAGE + 1) as client:
        geometry = client.geometry()
        assert (geometry.slot_length, geometry.frame_length, geometry.depth) == (2 * PAGE, PAGE + 1, 1)
        assert (geometry.stream, geometry.shape, geometry.writable) == ("memory", (PAGE + 1,), True)
        _, _, fds = client.next(packets.SLOTS)
        head, _, _ = client.next(packets.ADDRESS)
        assert (head.length, head.sequence % PAGE, head.sequence > 0) == (PAGE + 1, 0, True)
        assert memory_used(camera) == 2 * PAGE
        for fd in fds:
            os.close(fd)
    until(lambda: memory_used(camera) == 0)


def test_a_board_without_a_configuration_port_gives_memory_of_a_channel(
    camera: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object, **__: object) -> None:
        raise DeviceNotFound(errno.ENOENT, "no /dev/cm_icap0")

    monkeypatch.setattr(Icap, "open", none)
    with allocated(camera, PAGE + 1) as client:
        assert client.next(packets.ADDRESS)[0].length == PAGE + 1


@pytest.mark.parametrize(
    ("length", "code", "words"),
    [(0, "invalid_request", "memory has at least one byte"), (8 * PAGE + 1, "busy", "MiB for one user")],
)
def test_an_impossible_allocation_is_refused(camera: Daemon, length: int, code: str, words: str) -> None:
    with allocated(camera, length) as client:
        found, message = client.refusal()
    assert (found, words in message) == (code, True), message

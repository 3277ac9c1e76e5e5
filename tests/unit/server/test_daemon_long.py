# SPDX-License-Identifier: Apache-2.0
"""Requests that are too long for one turn: uploads in parts, many registers at once, memory for the PL."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from daemon_thread import HUNG, Daemon, Subscriber, daemon
from manager_process import until

from cm.device import AxiDma, DeviceNotFound, DmaBuffer, Icap
from cm.manager.manager import Settings
from cm.server.settings.model import USUAL
from cm.wire import plane_packets as packets
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ChangeMode, ConfigureStream, File, ReadReg, RegWrite, Upload, WriteReg
from cm.wire.messages.status import RegValues, UploadInfo
from cm.wire.plane_packets import Descriptor, Open

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
    assert flowing.done(Upload("a", FRAME, 0, PICTURE[:1000])) == UploadInfo("a", FRAME, 1000)
    assert flowing.done(Upload("a", FRAME, 1000, PICTURE[1000:])) == UploadInfo("a", FRAME, FRAME)
    assert uploaded(flowing) == FRAME
    flowing.send(rq.ReadData("from_pl", 60.0))
    flowing.send(rq.WriteData("to_pl", upload="a"))
    payloads = [reply.payload for reply in (flowing.reply(), flowing.reply()) if reply.payload]
    assert [bytes(payload[0]) for payload in payloads] == [PICTURE]
    assert uploaded(flowing) == 0
    code, message = flowing.refused(rq.WriteData("to_pl", upload="a"))
    assert (code, "there is no upload of that name" in message) == ("unknown_upload", True)


def test_an_incomplete_upload_is_not_used_until_it_is_complete(flowing: Daemon) -> None:
    flowing.done(Upload("a", FRAME, 0, PICTURE[:10]))
    code, message = flowing.refused(rq.WriteData("to_pl", upload="a"))
    assert (code, f"10 of {FRAME} bytes are there" in message) == ("unknown_upload", True)
    flowing.done(Upload("a", FRAME, 10, PICTURE[10:]))
    flowing.done(rq.WriteData("to_pl", upload="a"))
    assert uploaded(flowing) == 0


def test_unused_uploads_are_limited_in_bytes(camera: Daemon) -> None:
    assert camera.done(Upload("a", MOST - 10, 0, b"x")).got == 1
    assert camera.refused(Upload("b", 11, 0, b"x"))[0] == "too_much_uploaded"
    camera.done(Upload("b", 10, 0, b"x"))
    assert uploaded(camera) == MOST
    for name in ("a", "b"):
        camera.done(Upload(name, discard=True))
    assert uploaded(camera) == 0


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
    daemon.done(Upload("image", len(image), 0, image))
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


def test_many_registers_are_read_like_a_few(camera: Daemon) -> None:
    few = camera.done(ReadReg(("focus", "zoom")))
    many = camera.done(ReadReg(("focus", "zoom") * (MANY // 2)))
    assert values(many) == values(few) * (MANY // 2)
    assert (many.config_name, many.mode) == ("camera", "default")


def test_many_writes_take_effect_in_their_order_and_are_published(camera: Daemon) -> None:
    seen = Subscriber(camera, b"cm_read_reg")
    done = camera.done(WriteReg(tuple(RegWrite("focus", number % 16) for number in range(MANY))))
    assert values(done) == [number % 16 for number in range(MANY)]
    told = seen.until(RegValues)
    assert values(told)[-1] == (MANY - 1) % 16
    assert values(camera.done(ReadReg(("focus",)))) == [(MANY - 1) % 16]
    seen.close()


def test_a_request_after_many_writes_of_the_same_sender_sees_them(camera: Daemon) -> None:
    camera.send(WriteReg(tuple(RegWrite("focus", number % 16) for number in range(MANY))))
    camera.send(ReadReg(("focus",)))
    first, second = camera.reply(), camera.reply()
    assert isinstance(first.body, RegValues)
    assert len(first.body.values) == MANY
    assert isinstance(second.body, RegValues)
    assert values(second.body) == [(MANY - 1) % 16]


def test_one_wrong_write_among_many_is_refused_before_any_is_made(camera: Daemon) -> None:
    camera.done(WriteReg((RegWrite("focus", 3),)))
    writes = [RegWrite("focus", number % 16) for number in range(MANY)]
    code, message = camera.refused(WriteReg((*writes, RegWrite("focsu", 1))))
    assert (code, "did you mean 'focus'?" in message) == ("unknown_register", True)
    assert values(camera.done(ReadReg(("focus",)))) == [3]
    assert camera.refused(ReadReg((*["focus"] * MANY, "focsu")))[0] == "unknown_register"


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


def test_many_writes_against_a_lease_are_refused(camera: Daemon) -> None:
    lease = camera.done(rq.TakeLease("registers:focus", holder="me"))
    writes = tuple(RegWrite("focus", 3) for _ in range(MANY))
    assert camera.refused(WriteReg(writes))[0] == "held_by"
    assert values(camera.done(WriteReg(writes, lease.id))) == [3] * MANY
    camera.done(rq.ReleaseLease(lease.id))


# ---- memory for masters in the PL --------------------------------------------------------------


class Allocated:
    """A client that asks for memory."""

    def __init__(self, daemon: Daemon, length: int) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.connect(str(daemon.folder / "run" / packets.SOCKET))
        self.socket.settimeout(HUNG / 1000)
        self.socket.send(packets.encode_open(Open("", allocate=True, length=length)))

    def next(self, kind: int) -> tuple[Descriptor, bytes, list[int]]:
        while True:
            data, fds, _, _ = socket.recv_fds(self.socket, packets.PACKET_MAX, packets.FDS_MAX)
            head = Descriptor(*packets.DESCRIPTOR.unpack_from(data))
            if head.kind == kind:
                return head, data, fds
            for fd in fds:
                os.close(fd)

    def close(self) -> None:
        self.socket.close()


def memory_used(daemon: Daemon) -> int:
    return int(daemon.board.control.state()["memory"])


def test_memory_has_an_address_and_is_freed_with_its_client(camera: Daemon) -> None:
    until(lambda: memory_used(camera) == 0)
    with contextlib.closing(Allocated(camera, PAGE + 1)) as client:
        geometry = packets.decode_geometry(client.next(packets.GEOMETRY)[1])
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
    before = len(list(Path("/proc/self/fd").iterdir()))
    with contextlib.closing(Allocated(camera, PAGE + 1)) as client:
        head, _, _ = client.next(packets.ADDRESS)
        assert (head.length, head.sequence % PAGE, head.sequence > 0) == (PAGE + 1, 0, True)
    until(lambda: len(list(Path("/proc/self/fd").iterdir())) <= before)
    monkeypatch.setattr("cm.server.devices.list_dma", lambda _: ())
    with contextlib.closing(Allocated(camera, PAGE)) as client:
        code, message = packets.decode_refused(client.next(packets.REFUSED)[1])
    assert (code, "it has neither a configuration port nor a DMA channel" in message) == ("not_found", True), message


def unknown(allocate: Callable[..., DmaBuffer], *given: object) -> DmaBuffer:
    made = allocate(*given)
    made.address = 0
    return made


@pytest.mark.parametrize("port", [True, False], ids=["of the port", "of a channel"])
def test_memory_whose_address_is_not_known_is_given_back(
    camera: Daemon, monkeypatch: pytest.MonkeyPatch, port: bool
) -> None:
    if not port:
        monkeypatch.setattr(
            "cm.server.devices.port_memory", lambda *_: (_ for _ in ()).throw(DeviceNotFound(2, "none"))
        )
    for device in (Icap, AxiDma):
        monkeypatch.setattr(device, "allocate", lambda *given, allocate=device.allocate: unknown(allocate, *given))
    with contextlib.closing(Allocated(camera, PAGE)) as client:
        code, message = packets.decode_refused(client.next(packets.REFUSED)[1])
    assert (code, "it is older than this package" in message) == ("not_found", True), message
    until(lambda: memory_used(camera) == 0)


def test_clients_get_separate_memory(camera: Daemon) -> None:
    with contextlib.ExitStack() as stack:
        made = [stack.enter_context(contextlib.closing(Allocated(camera, PAGE))) for _ in range(3)]
        addresses = {client.next(packets.ADDRESS)[0].sequence for client in made}
    assert len(addresses) == 3
    until(lambda: memory_used(camera) == 0)


@pytest.mark.parametrize(
    ("length", "code", "words"),
    [(0, "invalid_request", "memory has at least one byte"), (8 * PAGE + 1, "busy", "MiB for one process")],
)
def test_an_impossible_allocation_is_refused(camera: Daemon, length: int, code: str, words: str) -> None:
    with contextlib.closing(Allocated(camera, length)) as client:
        found, message = packets.decode_refused(client.next(packets.REFUSED)[1])
    assert (found, words in message) == (code, True), message


def test_memory_is_given_up_to_the_limit(camera: Daemon) -> None:
    until(lambda: memory_used(camera) == 0)
    with contextlib.closing(Allocated(camera, 8 * PAGE)) as client:
        assert client.next(packets.ADDRESS)[0].length == 8 * PAGE
    until(lambda: memory_used(camera) == 0)

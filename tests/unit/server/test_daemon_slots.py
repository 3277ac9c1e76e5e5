# SPDX-License-Identifier: Apache-2.0
"""Slots are allocated a few at a time: how others are served meanwhile, and what happens if it ends half way."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from daemon_thread import HUNG, Daemon, Subscriber, daemon
from data_client import Client
from manager_process import until

from cm.device import AxiDma, DeviceError
from cm.device.data_plane import Plane
from cm.server.devices import BoardDevices
from cm.server.sockets import Loop
from cm.server.streams.machine import Step, StepKind
from cm.server.streams.stream import AT_ONCE, OpenStream
from cm.wire import plane_packets as packets
from cm.wire.messages import requests as rq
from cm.wire.messages.requests import ConfigureStream
from cm.wire.messages.status import ErrorInfo, StreamStatus
from cm.wire.plane_packets import Open, Purpose

MIB = 1 << 20
DEPTH = 64
WITH = DEPTH + 2  # with those of the hardware
SPARE = 4 * MIB  # for images that are loaded ahead; twenty slots are more


class Allocator:
    """Counts the slots allocated in each turn of the loop; can hold or fail a stream's allocation after some slots."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.most = self.all = self.given = self._now = self._given_now = 0
        self.at = 1 << 20
        self.opened = threading.Event()
        self.reached = threading.Event()
        self.fails_at = 1 << 20
        wait, take, allocate, add = Loop._wait, OpenStream.take, AxiDma.allocate, Plane.add_slot
        of: dict[AxiDma, int] = {}

        def turn(loop: Loop, milliseconds: int) -> None:
            self.most, self.given = max(self.most, self._now), max(self.given, self._given_now)
            self._now = self._given_now = 0
            wait(loop, milliseconds)

        def take_step(stream: OpenStream, step: Step) -> None:
            if step.kind is not StepKind.ALLOCATE or self.opened.is_set():
                take(stream, step)
            elif len(stream.slots) < self.at:
                take(stream, step._replace(slots=min(step.slots, self.at)))
            else:
                self.reached.set()
                stream.machine.took(step, stream.machine.made, stream.machine.given)

        def allocated(channel: AxiDma, length: int) -> Any:
            of[channel] = of.get(channel, 0) + 1
            if of[channel] >= self.fails_at:
                raise DeviceError(errno.ENOMEM, "cannot allocate: no memory for DMA")
            self._now += 1
            self.all += 1
            return allocate(channel, length)

        def added(plane: Plane, *arguments: int) -> int:
            self._given_now += 1
            return add(plane, *arguments)

        patch.setattr(Loop, "_wait", turn)
        patch.setattr(OpenStream, "take", take_step)
        patch.setattr(AxiDma, "allocate", allocated)
        patch.setattr(Plane, "add_slot", added)

    def hold(self, at: int) -> None:
        """Let no stream have more slots than this until `opened` is set; `reached` is set when one wants more."""
        self.at = at

    def held(self) -> None:
        assert self.reached.wait(60)


@pytest.fixture
def slots(monkeypatch: pytest.MonkeyPatch) -> Allocator:
    return Allocator(monkeypatch)


@pytest.fixture
def camera(slots: Allocator) -> Iterator[Daemon]:
    del slots  # patched before the daemon begins
    with daemon(["--rate", "200"]) as made:
        made.load("default")
        yield made


@pytest.fixture
def client() -> Iterator[Callable[..., Client]]:
    with contextlib.ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(contextlib.closing(Client(*arguments)))


def memory(of: Daemon) -> int:
    return int(of.board.control.state()["memory"])


def reads(reader: Client, frames: int = 5) -> list[int]:
    """The numbers of frames, each of which is given back."""
    numbers = []
    for _ in range(frames):
        head, _, _ = reader.next(packets.FRAME)
        reader.send(head, packets.RELEASE)
        numbers.append(head.sequence)
    return numbers


def closed(of: Daemon, name: str = "camera") -> bool:
    return not of.stream(name).open


# ---- turns ---------------------------------------------------------------------------------------


def test_no_turn_of_the_loop_makes_more_than_eight_slots(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    one = client(camera, Open("camera", depth=60))
    reads(one)
    assert slots.all == 62
    other = client(camera, Open("camera", depth=4))
    reads(other)
    assert slots.all == WITH
    assert (slots.most, slots.given) <= (AT_ONCE, AT_ONCE)
    camera.load("colorise")  # it is reopened for both
    for reader in (one, other):
        while reader.geometry().mode != "colorise":
            pass
        reads(reader)
    assert slots.all == 2 * WITH
    assert slots.most <= 2 * AT_ONCE  # a step for each
    camera.load("loopback")
    assert client(camera, Open("to_pl", Purpose.WRITE, depth=DEPTH)).geometry().depth == DEPTH
    assert slots.all == 2 * WITH + DEPTH
    assert slots.given <= 2 * AT_ONCE


def test_a_setting_is_answered_once_its_slots_are_made_turn_by_turn(slots: Allocator, camera: Daemon) -> None:
    told = camera.done(ConfigureStream("camera", slots=200, enable=True, force=True))
    assert (told.slots, told.open) == (200, True)
    assert slots.all == 200
    assert slots.most <= AT_ONCE
    until(lambda: camera.stream("camera").frames > 3)


def test_requests_are_served_while_slots_are_made(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    camera.done(rq.WriteReg((rq.RegWrite("focus", 3),)))
    assert camera.stream("camera").frames == 0  # it begins with its reader
    slots.opened.set()
    assert reader.geometry().depth == DEPTH
    assert reads(reader) == [0, 1, 2, 3, 4]


# ---- half way ------------------------------------------------------------------------------------


def test_a_reader_that_hangs_up_half_way_leaves_nothing(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    before = memory(camera)
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    reader.close()
    until(lambda: closed(camera))
    until(lambda: memory(camera) < before + SPARE)
    slots.opened.set()
    assert reads(client(camera, Open("camera", depth=4)), 4) == [0, 1, 2, 3]  # later ones may be dropped


def test_slots_for_a_reader_that_hangs_up_half_way_are_freed_while_another_reads(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    other = client(camera, Open("camera", depth=4))
    reads(other)
    had = camera.stream("camera").slots
    slots.hold(20)
    reader = client(camera, Open("camera", depth=60))
    slots.held()
    assert camera.stream("camera").slots == 20
    reader.close()
    until(lambda: camera.stream("camera").slots == had)
    reads(other)


def test_a_reader_that_waits_for_slots_gets_the_next_mode(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    camera.load("colorise")
    reader.next(packets.STOPPED)
    slots.opened.set()
    geometry = reader.geometry()
    assert (geometry.mode, geometry.depth) == ("colorise", DEPTH)
    assert len(reads(reader)) == 5


def test_a_stream_that_is_stopped_half_way_goes_on_when_it_may(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    before = memory(camera)
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    camera.done(ConfigureStream("camera", enable=False))
    reader.next(packets.STOPPED)
    assert memory(camera) < before + SPARE
    slots.opened.set()
    camera.done(ConfigureStream("camera", automatic=True))
    assert reader.geometry().depth == DEPTH
    assert reads(reader) == [0, 1, 2, 3, 4]


def test_a_board_that_goes_half_way_is_reported(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    camera.board.kill()
    slots.opened.set()
    told, data, _ = reader.next(packets.REFUSED, packets.STOPPED)  # before or after it got its slots
    if told.kind == packets.REFUSED:
        assert packets.decode_refused(data)[0] == "device_gone"
    else:
        assert told.offset == errno.ENODEV
    until(lambda: not [stream for stream in camera.status.streams if stream.open])


def test_a_board_that_does_not_answer_half_way_is_taken_up_again(
    slots: Allocator, monkeypatch: pytest.MonkeyPatch, client: Callable[..., Client]
) -> None:
    monkeypatch.setenv("CM_SIM_TIMEOUT", "3")
    with daemon(["--rate", "200"]) as made:
        made.load("default")
        slots.hold(20)
        reader = client(made, Open("camera", depth=DEPTH))
        slots.held()
        os.kill(made.board.pid, signal.SIGSTOP)
        try:
            slots.opened.set()
            assert reader.refusal()[0] == "timeout"
            assert made.refused(rq.ReadData("camera", 1.0))[0] == "timeout"
        finally:
            os.kill(made.board.pid, signal.SIGCONT)
        until(lambda: made.ask(rq.ReadData("camera", 30.0)).error is None)


def test_another_reader_that_asks_meanwhile_misses_no_frame_either(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    slots.hold(4)  # fewer than the stream's own
    first = client(camera, Open("camera", depth=40))
    slots.held()
    second = client(camera, Open("camera", depth=20))
    until(lambda: len(camera.server._data_socket._under_way) == 2)
    slots.opened.set()
    assert [reader.geometry().depth for reader in (first, second)] == [40, 20]
    assert reads(first) == reads(second) == [0, 1, 2, 3, 4]
    assert camera.stream("camera").slots == 62


def test_a_reader_with_its_slots_does_not_wait_for_one_without_end(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    slots.hold(20)
    slow = client(camera, Open("camera", depth=60))
    slots.held()
    quick = client(camera, Open("camera", depth=4))
    assert quick.geometry().depth == 4
    assert reads(quick, 4) == [0, 1, 2, 3]  # as many as it has room for: later ones may be dropped
    slots.opened.set()
    assert slow.geometry().depth == 60
    reads(slow)


def test_so_many_connections_of_a_process_wait_for_their_turn(
    slots: Allocator, camera: Daemon, client: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.streams.data_socket._QUEUED", 4)  # three for a process
    slots.hold(3)
    waiting = [client(camera, Open("camera", depth=4)) for _ in range(3)]
    slots.held()
    code, message = client(camera, Open("camera", depth=4)).refusal()
    said = "3 connections of this process and 3 of all wait for their turn, of 4, the last of which are for others; try"
    assert (code, message[: len(said)]) == ("busy", said)
    slots.opened.set()
    for one in waiting:
        assert one.geometry().depth == 4
    assert client(camera, Open("camera", depth=4)).geometry().depth == 4


def test_a_single_read_waits_for_the_slots_of_a_stream(slots: Allocator, camera: Daemon) -> None:
    slots.hold(2)
    camera.send(rq.ReadData("camera", 60.0))
    slots.held()
    slots.opened.set()
    assert camera.reply().error is None


def test_the_daemon_ends_while_slots_are_made(slots: Allocator, camera: Daemon, client: Callable[..., Client]) -> None:
    slots.hold(20)
    reader = client(camera, Open("camera", depth=DEPTH))
    slots.held()
    camera.close()
    while reader.socket.recv(packets.PACKET_MAX):
        pass  # until it is disconnected


# ---- faults --------------------------------------------------------------------------------------


def test_if_a_slot_cannot_be_allocated_half_way_all_are_freed(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    before = memory(camera)
    slots.fails_at = 40
    code, message = client(camera, Open("camera", depth=DEPTH)).refusal()
    assert (code, "no memory for a client of 64 frames more" in message) == ("no_slots", True), message
    until(lambda: closed(camera))
    until(lambda: memory(camera) < before + SPARE)
    slots.fails_at = 1 << 20
    assert reads(client(camera, Open("camera", depth=DEPTH))) == [0, 1, 2, 3, 4]


def test_if_a_slot_cannot_be_allocated_other_readers_go_on(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    other = client(camera, Open("camera", depth=32))
    reads(other)
    had, used = camera.stream("camera").slots, memory(camera)
    slots.fails_at = 40
    assert client(camera, Open("camera", depth=30)).refusal()[0] == "no_slots"
    slots.fails_at = 0
    subscriber = Subscriber(camera, b"cm_stream/camera")
    until(lambda: "frames of 'camera' do not pass over ZeroMQ" in str(camera.status.last_error))
    subscriber.close()
    until(lambda: camera.stream("camera").slots == had)
    until(lambda: memory(camera) < used + SPARE)
    reads(other)
    slots.fails_at = 1 << 20
    assert client(camera, Open("camera", depth=30)).geometry().depth == 30


def test_if_a_stream_gets_no_slots_at_all_everyone_is_told_why_and_it_is_tried_again_after_a_while(
    slots: Allocator, camera: Daemon, client: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.streams.lifecycle._REST", 3600.0)
    until(lambda: closed(camera))
    camera.done(ConfigureStream("camera", slots=4))
    made, slots.fails_at = slots.all, 3
    reader = Subscriber(camera, b"cm_stream/camera")
    why = "stream 'camera' cannot be opened: cannot allocate: no memory for DMA"
    until(lambda: camera.stream("camera").last_error == ErrorInfo("device_error", why))
    assert camera.status.last_error == ErrorInfo("device_error", why)
    assert [camera.stream("camera").open for _ in range(50)] == [False] * 50
    assert slots.all == made + 2  # of one attempt
    code, message = client(camera, Open("camera", depth=4)).refusal()
    assert (code, "no memory for DMA" in message) == ("device_error", True), message
    code, message = camera.refused(rq.ReadData("camera", 30.0))
    assert (code, "no memory for DMA" in message) == ("device_error", True), message
    monkeypatch.setattr("cm.server.streams.lifecycle._REST", 0.0)
    camera.load("colorise")  # which forgets it
    slots.fails_at = 1 << 20
    until(lambda: camera.stream("camera").open)
    reader.close()


def test_all_who_wait_for_a_stream_s_first_slots_are_refused_when_there_are_none(
    slots: Allocator, camera: Daemon, client: Callable[..., Client], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.server.streams.lifecycle._REST", 3600.0)
    until(lambda: closed(camera))
    slots.at = 1  # so that both wait
    waiting = [client(camera, Open("camera", depth=4)) for _ in range(3)]
    assert slots.reached.wait(HUNG / 1000)
    assert [camera.stream("camera").open for _ in range(20)] == [True] * 20  # until the others were heard, too
    slots.fails_at = 1
    slots.opened.set()
    refusals = [each.refusal() for each in waiting]
    assert [(code, "no memory for DMA" in message) for code, message in refusals] == [("device_error", True)] * 3


def test_a_setting_whose_slots_cannot_be_allocated_is_not_applied(slots: Allocator, camera: Daemon) -> None:
    camera.done(ConfigureStream("camera", rate=50.0))
    before = camera.stream("camera")
    slots.fails_at = 100
    code, message = camera.refused(ConfigureStream("camera", slots=200, enable=True))
    assert (code, "no memory for DMA" in message) == ("device_error", True), message
    slots.fails_at = 1 << 20
    after: StreamStatus = camera.stream("camera")
    assert (after.slots, after.limit, after.open) == (before.slots, 50.0, False)
    assert camera.ask(rq.ReadData("camera", 30.0)).error is None


def test_a_setting_of_a_stream_that_goes_before_it_has_started_is_answered(slots: Allocator, camera: Daemon) -> None:
    slots.hold(2)
    camera.send(ConfigureStream("camera", slots=200, enable=True))
    slots.held()
    camera.server._streams.resume(None, None, {})  # a mode that has no such stream
    error = camera.reply().error
    assert error == ErrorInfo("stream_stopped", "stream 'camera' was stopped: this mode has none of that name")


def test_a_client_that_waited_for_a_mode_and_gets_no_slots_is_disconnected(
    slots: Allocator, camera: Daemon, client: Callable[..., Client]
) -> None:
    reader = client(camera, Open("camera", depth=DEPTH))
    reads(reader)
    slots.fails_at = 40
    camera.load("colorise")
    while reader.socket.recv(packets.PACKET_MAX):
        pass  # until it is disconnected
    told: ErrorInfo | None = camera.status.last_error
    assert told is not None
    assert (told.code, "'camera' was hung up on" in told.message) == ("no_slots", True)


# ---- memory for masters in the PL ----------------------------------------------------------------


class Gate:
    """Memory is allocated when the gate is open."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.opened, self.reached = threading.Event(), threading.Event()
        self.error: Exception | None = None
        take = BoardDevices.port_memory

        def held(devices: BoardDevices, length: int) -> Any:
            self.reached.set()
            assert self.opened.wait(60)
            if self.error is not None:
                raise self.error
            return take(devices, length)

        patch.setattr(BoardDevices, "port_memory", held)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Gate:
    """To be asked for before the daemon."""
    return Gate(monkeypatch)


def allocating(of: Daemon, client: Callable[..., Client], length: int) -> Client:
    return client(of, Open("", Purpose.ALLOCATE, length=length))


def test_requests_are_served_while_memory_is_allocated(
    gate: Gate, camera: Daemon, client: Callable[..., Client]
) -> None:
    one = allocating(camera, client, MIB)
    assert gate.reached.wait(60)
    camera.done(rq.WriteReg((rq.RegWrite("focus", 3),)))
    gate.opened.set()
    assert one.next(packets.ADDRESS)[0].length == MIB


def test_memory_that_is_being_allocated_counts(gate: Gate, camera: Daemon, client: Callable[..., Client]) -> None:
    one = allocating(camera, client, 150 * MIB)
    assert gate.reached.wait(60)
    code, message = allocating(camera, client, 50 * MIB).refusal()
    assert (code, "192 MiB for one user" in message) == ("busy", True), message
    one.close()
    until(lambda: not camera.server._streams.memories.held())
    gate.opened.set()
    assert allocating(camera, client, 50 * MIB).next(packets.ADDRESS)[0].length == 50 * MIB


def test_memory_for_a_client_that_has_gone_is_given_back(
    gate: Gate, camera: Daemon, client: Callable[..., Client]
) -> None:
    before = memory(camera)
    one = allocating(camera, client, 32 * MIB)
    assert gate.reached.wait(60)
    one.close()
    until(lambda: not camera.server._streams.memories.held())
    gate.opened.set()
    allocating(camera, client, MIB).next(packets.ADDRESS)  # comes behind the other
    until(lambda: memory(camera) < before + MIB + SPARE)


def test_memory_that_cannot_be_allocated_is_refused_and_no_longer_counts(
    gate: Gate, camera: Daemon, client: Callable[..., Client]
) -> None:
    gate.error = DeviceError(errno.ENOMEM, "cannot allocate: no memory in one piece")
    gate.opened.set()
    code, message = allocating(camera, client, MIB).refusal()
    assert (code, "no memory in one piece" in message) == ("device_error", True)
    assert not camera.server._streams.memories.held()


def test_the_daemon_ends_while_memory_is_allocated(gate: Gate, camera: Daemon, client: Callable[..., Client]) -> None:
    one = allocating(camera, client, MIB)
    assert gate.reached.wait(60)
    camera.server.stop()
    gate.opened.set()
    camera.close()
    while one.socket.recv(packets.PACKET_MAX):  # an answer may have been on its way; then it is hung up
        pass

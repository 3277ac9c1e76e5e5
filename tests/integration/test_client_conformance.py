# SPDX-License-Identifier: Apache-2.0
"""The promises of the client, kept by both: the blocking and the asyncio one, over ipc and tcp."""

from __future__ import annotations

import gc
import inspect
import os
import pickle
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from client_twins import PROPERTIES, connected
from manager_process import CAMERA, Manager, served, until

import cm
from cm.client import board as blocking
from cm.client import change, events, interrupts, lease, memories, registers, stream, writer
from cm.client.aio import board as awaited
from cm.client.aio import change as aio_change
from cm.client.aio import events as aio_events
from cm.client.aio import interrupts as aio_interrupts
from cm.client.aio import lease as aio_lease
from cm.client.aio import memories as aio_memories
from cm.client.aio import registers as aio_registers
from cm.client.aio import stream as aio_stream
from cm.client.aio import writer as aio_writer
from cm.client.errors import (
    BoardClosed,
    ConnectionLost,
    RequestBusy,
    RequestFailed,
    RequestInvalid,
    RequestNotFound,
)
from cm.errors import InvalidRequest, Timeout
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware import camera
from cm.wire.messages.status import Progress

PICTURE = (np.arange(480 * 640) % 251).astype(np.uint8).reshape(480, 640)


@pytest.fixture(scope="module")
def both() -> Iterator[tuple[Manager, SimBoard]]:
    """A manager that listens on ipc and tcp."""
    with served(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as served_:
        yield served_


def reached(manager: Manager, way: str) -> dict[str, Any]:
    """Arguments of `connect` to reach it."""
    if way == "ipc":
        return {"runtime_dir": manager.runtime}
    return {"endpoint": manager.tcp()}


@pytest.fixture(params=[(kind, way) for kind in ("blocking", "asyncio") for way in ("ipc", "tcp")], ids="-".join)
def reach(request: pytest.FixtureRequest, both: tuple[Manager, SimBoard]) -> tuple[str, dict[str, Any]]:
    kind, way = request.param
    return kind, reached(both[0], way)


@pytest.fixture
def board(reach: tuple[str, dict[str, Any]]) -> Iterator[Any]:
    kind, how = reach
    with connected(kind, timeout=60, **how) as connected_:
        connected_.load("camera", "default", force=True)
        yield connected_


@pytest.fixture
def other(reach: tuple[str, dict[str, Any]]) -> Iterator[Any]:
    """Another client of the same board."""
    with cm.connect(timeout=60, **reach[1]) as connected_:
        yield connected_


@pytest.fixture
def sim(both: tuple[Manager, SimBoard]) -> SimBoard:
    return both[1]


# ---- state and changes ----------------------------------------------------------------------------


def test_status_tells_what_is_loaded(board: Any) -> None:
    status = board.status
    assert (status.config_name, status.mode, status.fpga_busy) == ("camera", "default", False)
    assert board.mode == "default"
    assert status.board == os.uname().nodename
    now = time.time_ns() - time.monotonic_ns()
    assert abs(status.realtime_offset_ns - now) < 3_600 * 10**9  # one machine: the clocks are the same


def test_configurations_can_be_listed_and_described(board: Any) -> None:
    assert board.configs == ("camera",)
    assert any(client.requests for client in board.clients())
    assert board.config().name == board.config("camera").name == "camera"
    with pytest.raises(RequestNotFound, match="camra"):
        board.config("camra")


def test_modes_regions_and_clocks_are_told_by_name(board: Any) -> None:
    assert board.modes == tuple(mode.name for mode in board.config().modes)
    assert {name: region.module for name, region in board.regions.items()} == {"prr0": "default", "prr1": None}
    assert {name: clock.name for name, clock in board.clocks.items()} == {name: name for name in board.clocks}


def test_a_mode_is_entered_with_or_without_a_look_at_its_progress(board: Any) -> None:
    told: list[Progress] = []
    assert board.set_mode("colorise", timeout=60) > 0
    assert board.load("camera", "edge_detection", progress=told.append, timeout=60) > 0
    assert board.mode == "edge_detection"
    assert {p.target_mode for p in told} <= {"edge_detection"}


def test_a_change_can_be_followed(board: Any) -> None:
    handle = board.load_async("camera", "edge_detection")
    assert handle.wait(timeout=60) > 0
    assert handle.done
    assert handle.number == board.status.last_change
    assert handle.progress is None
    assert repr(handle) == f"<change {handle.number}, ended>"
    assert board.mode == "edge_detection"


def test_waiting_for_a_change_raises_the_error_it_failed_with(board: Any, sim: SimBoard) -> None:
    sim.control.inject("icap_crc", count=1)
    handle = board.load_async("camera", "edge_detection")
    with pytest.raises(RequestFailed, match="default"):
        handle.wait(timeout=60)
    assert handle.done
    assert board.mode == "default"


def test_cancelling_a_change_that_is_not_running_does_nothing(board: Any) -> None:
    handle = board.load_async("camera", "edge_detection")
    handle.wait(timeout=60)
    handle.cancel()
    board.cancel()
    assert board.mode == "edge_detection"


def test_a_region_is_unloaded_and_loaded_again(board: Any, sim: SimBoard) -> None:
    steps = [step.kind for step in board.plan(unload="prr0").steps]
    assert steps == ["validate", "quiesce", "overlay_remove", "decouple", "publish"]
    assert board.unload("prr0") > 0
    assert (board.mode, board.regions["prr0"].state, board.regions["prr0"].module) == ("", "decoupled", None)
    assert sim.control.state()["regions"]["prr0"]["decoupled"]
    with pytest.raises(RequestFailed):
        board.stream("camera", timeout=1).read()
    assert board.unload() > 0
    assert board.regions["prr1"].state == "decoupled"
    with pytest.raises(RequestNotFound, match="nope"):
        board.unload("nope")
    board.set_mode("default")
    assert board.regions["prr0"].state == "ready"


def test_watching_begins_with_the_present_status(board: Any) -> None:
    with board.watch(timeout=60) as watch:
        assert watch.next().config_name == "camera"
        board.set_mode("edge_detection")
        assert any(status.mode == "edge_detection" for status in watch)
        while watch.poll() is not None:
            pass
        assert watch.fileno() >= 0
        with pytest.raises(Timeout, match=r"0\.05 s"):
            _to_the_last(watch)


def _to_the_last(watch: Any) -> None:
    """Drain the events that were still on their way."""
    while True:
        watch.next(0.05)


def test_a_configuration_can_be_sent(board: Any, sim: SimBoard, tmp_path: Path) -> None:
    schema = tmp_path / "camera.yaml"
    text = (CAMERA / "camera.yaml").read_text()
    files = sorted((sim.root / "lib/firmware/cm/camera").iterdir())
    schema.write_text(text)
    with pytest.raises(RequestInvalid, match="the administrator's"):
        board.provision(schema, *files)
    schema.write_text(text.replace("name: camera", "name: sent", 1))
    assert board.provision(schema, *files).name == "sent"
    (entry,) = [entry for entry in board.config_entries() if entry.name == "sent"]
    assert (entry.origin, entry.bytes > 10_000, "uid" in entry.owner or "without a key" in entry.owner) == (
        "client",
        True,
        True,
    )
    board.remove_config("sent")
    assert [entry.origin for entry in board.config_entries()] == ["administrator"]


# ---- leases ---------------------------------------------------------------------------------------


def test_within_a_lease_its_holders_own_calls_pass_and_others_do_not(board: Any, other: Any) -> None:
    with board.lease("region:prr0", seconds=60, holder="the test") as lease_:
        assert lease_.scope == "region:prr0"
        assert lease_.id in repr(lease_)
        with pytest.raises(RequestBusy, match="held by the test"):
            other.set_mode("edge_detection")
        board.set_mode("edge_detection")
        lease_.renew()
        other.set_mode("default", lease=lease_.id)
    other.set_mode("edge_detection")


def test_what_ends_a_block_passes_as_it_is_although_its_lease_has_ended_before(
    board: Any, both: tuple[Manager, SimBoard]
) -> None:
    def ended(error: BaseException | None = None) -> None:
        with both[0].connected() as admin:
            admin.break_lease(next(one.number for one in admin.status.leases if one.scope == "registers:focus"))
        if error is not None:
            raise error

    with pytest.raises(KeyboardInterrupt), board.lease("registers:focus"):
        ended(KeyboardInterrupt())
    with pytest.raises(RequestNotFound, match="it may have ended"), board.lease("registers:focus"):
        ended()


def test_several_leases_are_used_together(board: Any, other: Any) -> None:
    with board.lease("region:prr0"), board.lease("registers:focus"):
        board.set_mode("edge_detection")
        board.registers.write({"focus": 3})
        with pytest.raises(RequestBusy):
            other.registers.write({"focus": 4})


# ---- registers ------------------------------------------------------------------------------------


def test_an_unknown_register_is_an_error_or_the_default(board: Any) -> None:
    board.registers.write({"focus": 2})
    assert board.registers.get("focus") == 2
    assert board.registers.get("focs") is None
    assert board.registers.get("focs", 7) == 7
    with pytest.raises(RequestNotFound, match="focs"):
        board.registers.read("focs")


def test_registers_are_mapped_on_the_managers_machine_only(board: Any, reach: tuple[str, dict[str, Any]]) -> None:
    if "endpoint" in reach[1]:
        with pytest.raises(InvalidRequest, match="only its own machine"):
            board.registers.window("prr0")
        return
    window = board.registers.window("prr0")
    window["focus"] = 9
    assert window["focus"] == board.registers.read("focus")["focus"] == 9
    window.close()


def test_a_fields_value_is_written_by_its_name(board: Any) -> None:
    assert board.registers.write({"led.blink": "fast"}) == {"led": board.registers.read("led")["led"]}
    assert board.registers.read("led.blink") == {"led.blink": 2}
    [blink] = [f for f in board.registers.info["led"].fields if f.name == "blink"]
    assert dict(blink.values) == {"steady": 0, "slow": 1, "fast": 2}
    with pytest.raises(RequestInvalid, match="did you mean 'fast'"):
        board.registers.write({"led.blink": "fsat"})
    assert board.registers.read("led.blink") == {"led.blink": 2}


def test_every_write_and_every_change_is_a_generation_of_its_own(board: Any, other: Any) -> None:
    first = board.registers.write({"focus": 2}).generation
    second = other.registers.write({"zoom": 1}).generation
    assert board.registers.generation == second > first > 0
    board.registers.write_masked("focus", 1, 3)
    third = board.registers.generation
    board.set_mode("edge_detection")
    assert board.registers.generation > third > second


def test_writes_are_published_to_subscribers(board: Any, other: Any) -> None:
    with board.registers.events("focus", timeout=60) as listening:
        other.registers.write({"zoom": 1})
        written = other.registers.write({"focus": 6})
        heard = [listening.next()]
        while heard[-1].values[0].value != 6:
            heard.append(listening.next())
        assert {v.name for values in heard for v in values.values} == {"focus"}
        assert heard[-1].generation == written.generation


def test_events_of_a_register_that_no_mode_has_are_refused_and_of_a_field_are_those_of_its_register(board: Any) -> None:
    for name, near in (("focs", "focus"), ("led.blnk", "led.blink")):
        with pytest.raises(RequestNotFound, match=f"{name}.*did you mean '{near}'"):
            board.registers.events("focus", name, timeout=60).next()
    with board.registers.events("led.blink", "threshold", timeout=60) as listening:  # the latter in another mode
        board.registers.write({"led.blink": 3})
        assert [v.name for v in listening.next().values] == ["led"]


# ---- interrupts -----------------------------------------------------------------------------------


def test_no_interrupt_is_lost_between_asking_and_waiting(board: Any, sim: SimBoard) -> None:
    for _ in range(10):
        with board.interrupts["frame_done"].events(timeout=60) as listening:
            before = board.interrupts["frame_done"].count
            sim.control.interrupt("frame_done")
            assert listening.next().count == before + 1


def test_a_wait_ends_with_an_interrupt_since_the_last_wait(board: Any, sim: SimBoard) -> None:
    """As PYNQ's does: one that comes between starting an accelerator and waiting for it is not missed."""
    interrupt = board.interrupts["loop_done"]
    board.set_mode("loopback")
    for _ in range(3):
        before = interrupt.count
        sim.control.interrupt("loop_done")
        until(lambda before=before: interrupt.count > before)
        assert board.interrupts["loop_done"].wait(timeout=60).count == before + 1
    with pytest.raises(Timeout):
        interrupt.wait(timeout=0.2)  # all that came were waited for
    with interrupt.events(timeout=0.2) as listening, pytest.raises(Timeout):
        listening.next()
    assert set(board.interrupts.names) == {"frame_done", "loop_done"}


def test_others_interrupts_do_not_prolong_the_time_out(board: Any, sim: SimBoard) -> None:
    board.set_mode("loopback")  # where the other interrupt can be acknowledged
    ended = threading.Event()

    def disturb() -> None:
        while not ended.wait(0.02):
            sim.control.interrupt("loop_done")

    disturber = threading.Thread(target=disturb)
    disturber.start()
    begun = time.monotonic()
    try:
        with pytest.raises(Timeout, match=r"frame_done.*0\.4 s"):
            board.interrupts["frame_done"].events(timeout=0.4).next()
        waited = time.monotonic() - begun
    finally:
        ended.set()
        disturber.join()
    assert waited < 30  # with a time-out that begins anew it would never have ended


# ---- data -----------------------------------------------------------------------------------------


def test_frames_come_in_their_shape(board: Any) -> None:
    for newest in (False, True):
        with board.stream("camera", timeout=60, newest=newest) as frames:
            assert frames.name == "camera"
            sequences = [frames.read().sequence for _ in range(3)]
            assert sequences == sorted(set(sequences))
            frame = next(iter(frames))
            assert (frame.shape, frame.info.mode) == ((480, 640), "default")
            assert frames.lost >= 0


@pytest.mark.parametrize("newest", [False, True])
def test_the_first_frame_after_a_write_shows_what_was_written(board: Any, sim: SimBoard, newest: bool) -> None:
    sharp, blurred = (set(_pictures(focus)) for focus in (1, 4))
    with board.stream("camera", timeout=60, newest=newest) as frames:
        for _ in range(5):
            for focus, right in ((4, blurred), (1, sharp)):
                written = board.registers.write({"focus": focus})
                frame = frames.after(written)
                assert frame.generation == frame.info.generation == written.generation
                assert frame.tobytes() in right
        kept = frames.after(board.registers.generation, timeout=60)
        assert pickle.loads(pickle.dumps(kept)).generation == written.generation


def _pictures(focus: int) -> Iterator[bytes]:
    """All pictures of the simulated board's camera."""
    for photo in camera.shipped_photos().values():
        yield camera.frame(photo, focus=focus).tobytes()


def test_waiting_for_a_later_write_lasts_as_long_as_requested(board: Any) -> None:
    with board.stream("camera", timeout=60) as frames:
        with pytest.raises(Timeout, match=r"generation \d+ within 0\.3 s"):
            frames.after(board.registers.generation + 1, timeout=0.3)
        with pytest.raises(InvalidRequest, match=r"registers\.write"):
            frames.after({"focus": 2})


def test_without_waiting_one_gets_what_is_there(board: Any, reach: tuple[str, dict[str, Any]]) -> None:
    def at_once(read: Callable[..., Any]) -> Any:
        try:
            return read(timeout=0).shape
        except Timeout:
            return None

    with board.stream("camera", timeout=60) as frames:
        frames.read()
        assert until(lambda: at_once(frames.read)) == (480, 640)
    if "endpoint" not in reach[1]:
        with board.echo(4096, timeout=60) as echo:
            echo.flush(timeout=0)
            echo.round_trip()  # then its slot is free again
            with echo.slot(timeout=0) as slot:
                slot[:] = 7
            echo.flush()
            echo.write(bytes(4096), timeout=0)
            with pytest.raises(InvalidRequest, match=r"frames of \(4096,\) uint8; this one is \(512,\) float64"):
                echo.write(np.zeros(512))


def test_what_a_stream_cannot_have_is_refused_whichever_way_its_frames_come(
    board: Any, reach: tuple[str, dict[str, Any]]
) -> None:
    with pytest.raises(RequestNotFound, match="did you mean 'camera'"):
        board.stream("camra", timeout=60).open()
    with pytest.raises(InvalidRequest, match=r"shape=480 .* \(480,\)"):
        board.configure_stream("camera", shape=480)
    with pytest.raises(InvalidRequest, match=r"depth (of )?-1"):
        board.stream("camera", depth=-1).open()
    if "endpoint" not in reach[1]:
        with pytest.raises(InvalidRequest, match="-1 bytes"), board.echo(-1):
            pass
        with pytest.raises(InvalidRequest, match="Python's objects"):
            board.allocate(3, "O")
        assert board.allocate(np.int64(3), "uint16").nbytes == 6


def test_a_time_out_may_be_none_or_infinite_and_nothing_else_but_a_number(board: Any) -> None:
    for forever in (None, float("inf"), 1e9):
        board.timeout = forever
        assert board.timeout is None
        assert board.plan("edge_detection").bytes > 0
        assert board.read("camera", timeout=forever).shape == (480, 640)
        with board.stream("camera", timeout=forever) as frames:
            frames.read()
            assert frames.read(timeout=forever).shape == (480, 640)
        with board.registers.events("focus", timeout=forever) as listening:
            board.registers.write({"focus": 2})
            listening.next(forever)
        assert board.load_async("camera", "default").wait(timeout=forever) >= 0
    for wrong in (float("nan"), "5"):
        with pytest.raises(InvalidRequest, match="number of seconds"):
            board.timeout = wrong
        with pytest.raises(InvalidRequest, match="number of seconds"):
            board.stream("camera", timeout=wrong).open()
        with pytest.raises(InvalidRequest, match="number of seconds"):
            board.read("camera", timeout=wrong)
    with board.interrupts["loop_done"].events(timeout=-1) as listening, pytest.raises(Timeout):
        listening.next()


def test_frames_are_read_and_written_with_a_copy(board: Any) -> None:
    board.set_mode("loopback")
    with board.stream("from_pl", timeout=60) as frames:
        frames.open()
        until(lambda: next(s for s in board.status.streams if s.name == "from_pl").open)
        assert board.write("to_pl", PICTURE).length == PICTURE.nbytes
        assert (frames.read() == PICTURE).all()
    board.set_mode("default")
    assert board.read("camera", timeout=60).shape == (480, 640)


def test_slots_are_borrowed_filled_and_sent(board: Any, reach: tuple[str, dict[str, Any]]) -> None:
    board.set_mode("loopback")
    if "endpoint" in reach[1]:
        with pytest.raises(InvalidRequest, match="only its own machine has"):
            board.writer("to_pl", timeout=60).close()
        with pytest.raises(InvalidRequest, match="only its own machine has"):
            board.echo(100, timeout=60).close()
        return
    with board.stream("from_pl", timeout=60) as frames, board.writer("to_pl", timeout=60) as sender:
        with sender.slot() as slot:
            slot[...] = PICTURE
        assert (frames.read() == PICTURE).all()
        sender.write(PICTURE)
        sender.flush()
        assert sender.under_way == 0
        assert (frames.read() == PICTURE).all()
    with board.echo(4096, timeout=60) as echo:
        assert echo.round_trip() is not None


def test_a_writer_goes_on_in_the_next_mode_and_loses_nothing(board: Any, reach: tuple[str, dict[str, Any]]) -> None:
    if "endpoint" in reach[1]:
        return  # has no writers
    board.set_mode("loopback")
    with board.stream("from_pl", timeout=60) as frames, board.writer("to_pl", timeout=60) as sender:
        for mode in ("loopback_edge", "loopback"):
            board.set_mode(mode)  # its slots are others now
            sender.write(PICTURE)
            assert frames.read().info.mode == mode
            with sender.slot() as slot:
                slot[...] = PICTURE
            assert frames.read().info.mode == mode


def test_memory_for_the_pl_is_an_array_with_an_address(board: Any, reach: tuple[str, dict[str, Any]]) -> None:
    if "endpoint" in reach[1]:
        with pytest.raises(InvalidRequest, match="only its own machine has"):
            board.allocate(16)
        return
    array, other = board.allocate((4, 1024), "uint32", timeout=60), board.allocate(16)
    assert (array.shape, array.dtype, int(array.sum())) == ((4, 1024), np.uint32, 0)
    assert array[1:].device_address == array.device_address + 4096
    assert abs(other.device_address - array.device_address) >= 4096
    array[...] = 7
    array.sync_to_device()
    array.sync_from_device()
    assert (array == 7).all()
    with pytest.raises(InvalidRequest, match="ordinary memory"):
        (array + 1).device_address  # noqa: B018
    array.free()
    with pytest.raises(InvalidRequest, match="no bytes"):
        board.allocate((0, 4))
    with pytest.raises(RequestBusy, match="256 MiB"):
        board.allocate(1 << 40)


# ---- the end --------------------------------------------------------------------------------------


def test_every_call_on_a_closed_board_says_that_it_is_closed(reach: tuple[str, dict[str, Any]]) -> None:
    kind, how = reach
    with connected(kind, timeout=60, **how) as board:
        board.load("camera", "default")
        stream_, watch = board.stream("camera", timeout=60), board.watch()
        stream_.open()
        handle = board.load_async("camera", "default")
        assert "closed" not in repr(board)
        board.close()
        board.close()
        assert "closed" in repr(board)
        for ask in (
            lambda: board.status,
            lambda: board.set_mode("default"),
            board.registers.read,
            lambda: board.interrupts["frame_done"].wait(1),
            board.memories["scratchpad"].read,
            lambda: board.watch().next(1.0),
            lambda: board.lease().take(),
            lambda: board.stream("camera", timeout=60).read(),
            stream_.read,
            lambda: watch.next(1.0),
            lambda: handle.wait(1.0),
        ):
            with pytest.raises(BoardClosed, match="was closed"):
                ask()


@pytest.mark.parametrize("way", ["ipc", "tcp"])
def test_a_board_that_is_closed_frees_all_threads_that_wait_in_it(both: tuple[Manager, SimBoard], way: str) -> None:
    """None of these calls would return by itself."""
    board = cm.connect(timeout=60, **reached(both[0], way))
    board.load("camera", "loopback")
    calls = _that_wait(board, way)
    ends: dict[str, BaseException] = {}

    def wait(name: str) -> None:
        try:
            calls[name]()
        except BaseException as error:  # noqa: BLE001 (which it is, is what the test is about)
            ends[name] = error

    threads = [threading.Thread(target=wait, args=(name,), daemon=True) for name in calls]
    for thread in threads:
        thread.start()
    with both[0].connected() as other:
        before = other.status.last_change
        until(lambda: other.status.last_change > before + 3)
    board.close()
    for thread in threads:
        thread.join(timeout=60)
    assert {name: type(ends.get(name)) for name in calls} == dict.fromkeys(calls, BoardClosed)


def test_threads_that_close_one_board_at_once_all_come_to_an_end(both: tuple[Manager, SimBoard]) -> None:
    """Other threads are waiting in it meanwhile."""
    problems: list[BaseException] = []

    def ended(work: Callable[[], Any]) -> None:
        try:
            work()
        except BoardClosed:
            pass
        except BaseException as error:  # noqa: BLE001
            problems.append(error)

    for _ in range(20):
        board = cm.connect(timeout=60, **reached(both[0], "ipc"))
        statuses = board.watch(timeout=None)
        works = [lambda watched=statuses: deque(watched, 0), *[board.close] * 4]
        threads = [threading.Thread(target=ended, args=(work,), daemon=True) for work in works]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(timeout=60)
        assert not any(thread.is_alive() for thread in threads)
    assert problems == []


def _that_wait(board: cm.Board, way: str) -> dict[str, Callable[[], Any]]:
    frames = board.stream("from_pl", timeout=None, newest=True)
    frames.open()
    statuses, streams = board.watch(timeout=None), board.stream("camera", timeout=None, copy=True)
    calls: dict[str, Callable[[], Any]] = {
        "statuses": lambda: deque(statuses, 0),
        "an interrupt": lambda: deque(board.interrupts["frame_done"].events(None), 0),
        "frames": lambda: deque(frames, 0),
        "published frames": lambda: deque(streams, 0),
        "changes": lambda: _changes(board),
        "their turn": lambda: _changes(board),
        "progress": lambda: _changes(board, progress=lambda _: None),
    }
    if way == "ipc":
        writer_ = board.writer("to_pl", timeout=None)
        calls["a slot"] = lambda: _every_slot(writer_)
    return calls


def _changes(board: cm.Board, **options: Any) -> None:
    while True:
        board.load("camera", "loopback", **options)


def _every_slot(writer_: writer.Writer) -> None:
    """Ask for more slots than exist, with nobody reading the other end."""
    while True:
        writer_.write(PICTURE)


@pytest.fixture(scope="module")
def mortal() -> Iterator[Manager]:
    """A manager that tests kill and start again."""
    with served(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as (manager, _):
        yield manager


@pytest.mark.parametrize("kind", ["blocking", "asyncio"])
@pytest.mark.parametrize("way", ["ipc", "tcp"])
def test_a_waiting_client_hears_at_once_that_the_manager_died(mortal: Manager, kind: str, way: str) -> None:
    with ExitStack() as clients:
        board = clients.enter_context(connected(kind, timeout=60, **reached(mortal, way)))
        board.load("camera", "default")
        asked: list[BaseException] = []

        def wait() -> None:
            try:
                board.read("from_pl", timeout=60.0)
            except (cm.CmError, OSError) as error:
                asked.append(error)

        board.set_mode("loopback")
        waiter = threading.Thread(target=wait)
        waiter.start()
        until(lambda: next(s for s in _streams(mortal) if s.name == "from_pl").open)
        mortal.kill()
        waiter.join(timeout=60)
        assert [type(error) for error in asked] == [ConnectionLost]
    mortal.start()


def _streams(manager: Manager) -> Any:
    with manager.connected() as board:
        return board.status.streams


# ---- the twins are twins --------------------------------------------------------------------------

TWINS: list[tuple[type, type]] = [
    (blocking.Board, awaited.Board),
    (registers.Registers, aio_registers.Registers),
    (interrupts.Interrupts, aio_interrupts.Interrupts),
    (interrupts.Interrupt, aio_interrupts.Interrupt),
    (events.EventStream, aio_events.EventStream),
    (change.ChangeHandle, aio_change.ChangeHandle),
    (lease.BoardLease, aio_lease.BoardLease),
    (memories.Memory, aio_memories.Memory),
    (memories.Memories, aio_memories.Memories),
    (stream.Stream, aio_stream.Stream),
    (writer.Writer, aio_writer.AsyncWriter),
    (writer.Transfers, aio_writer.AsyncTransfers),
]
# For mappings, for event loops, for what a thread has to do itself; blocks, whose accesses are not awaited.
ONLY = {
    "Board": {"blocks"},
    "Registers": {"clear", "items", "keys", "pop", "popitem", "setdefault", "update", "values"},
    "Memories": {"get", "items", "keys", "values"},
    "EventStream": {"open"},
    "Stream": {"aclose"},
    "Writer": {"poll", "fileno", "open", "catch_up", "lend", "send", "nothing"},
    "Transfers": {"poll", "fileno", "open", "catch_up", "lend", "send", "nothing", "moved"},
}


def public(owner: type) -> dict[str, Any]:
    return {n: inspect.getattr_static(owner, n) for n in dir(owner) if not n.startswith("_")}


@pytest.mark.parametrize(("one", "twin"), TWINS, ids=lambda owner: f"{owner.__module__}.{owner.__name__}")
def test_both_have_the_same_names(one: type, twin: type) -> None:
    differing = public(one).keys() ^ public(twin).keys()
    assert differing <= ONLY.get(one.__name__, set())


@pytest.mark.parametrize(("one", "twin"), TWINS, ids=lambda owner: f"{owner.__module__}.{owner.__name__}")
def test_both_take_the_same_arguments_with_the_same_defaults(one: type, twin: type) -> None:
    for name in public(one).keys() & public(twin).keys():
        a, b = public(one)[name], public(twin)[name]
        if isinstance(a, property):
            assert isinstance(b, property) or name in PROPERTIES, name
            continue
        assert parameters(a) == parameters(b), name


def parameters(function: Any) -> list[tuple[str, Any, Any]]:
    found = inspect.signature(getattr(function, "__wrapped__", function)).parameters.values()
    return [(p.name, p.kind, p.default) for p in found]


# ---- what only one of them has --------------------------------------------------------------------


@pytest.fixture
def plain(both: tuple[Manager, SimBoard]) -> Iterator[cm.Board]:
    with cm.connect(runtime_dir=both[0].runtime, timeout=60) as board:
        board.load("camera", "default", force=True)
        yield board


def test_brackets_and_properties_are_assigned_to_by_the_blocking_client(plain: cm.Board) -> None:
    plain.mode = "edge_detection"
    plain.registers["focus"] = 4
    assert (plain.mode, plain.registers["focus"]) == ("edge_detection", 4)
    assert "focus" in plain.registers
    assert "focs" not in plain.registers
    assert plain.registers.focus == 4  # type: ignore[attr-defined]
    assert "focus" in dir(plain.registers)
    with pytest.raises(AttributeError, match="focs"):
        _ = plain.registers.focs  # type: ignore[attr-defined]


def test_a_misspelt_name_never_changes_hardware_silently(plain: cm.Board) -> None:
    with pytest.raises(AttributeError, match="did you mean 'mode'"):
        plain.moed = "edge_detection"  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"registers\['focus'\] = 9"):
        plain.registers.focus = 9  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="cannot be set"):
        plain.status = 3  # type: ignore[assignment, misc]


def test_asyncio_says_what_to_write_instead_of_an_assignment(both: tuple[Manager, SimBoard]) -> None:
    with connected("asyncio", runtime_dir=both[0].runtime, timeout=60) as board:
        with pytest.raises(AttributeError, match=r"await board\.set_mode"):
            board.mode = "edge_detection"
        with pytest.raises(TypeError, match=r"await board\.registers\.write"):
            board.registers._target["focus"] = 3
        with pytest.raises(AttributeError, match=r"await board\.registers\.write"):
            board.registers.focus = 3
        with pytest.raises(TypeError, match=r"await board\.memories\['scratchpad'\]\.put\(0, …\)"):
            board.memories["scratchpad"]._target[0] = 3


def test_a_frame_keeps_what_is_known_of_it_when_it_is_pickled(plain: cm.Board) -> None:
    with plain.stream("camera", timeout=60) as frames:
        frame = frames.read()
        again = pickle.loads(pickle.dumps(frame))
        assert (again == frame).all()
        assert (again.info, again.sequence, again.flags.writeable) == (frame.info, frame.sequence, False)
        number = frame.sequence
        frame.release()
        assert repr(frame) == str(frame) == f"<frame {number} of 'camera', given back>"


CHAINS = {
    "stream": "cm.connect(runtime_dir=D).stream('camera', timeout=60)",
    "newest": "cm.connect(runtime_dir=D).stream('camera', timeout=60, newest=True)",
    "far": "cm.connect(E).stream('camera', timeout=60)",
    "far newest": "cm.connect(E).stream('camera', timeout=60, newest=True)",
}


@pytest.mark.parametrize("chain", CHAINS)
def test_a_stream_of_a_board_that_has_no_name_goes_on(both: tuple[Manager, SimBoard], chain: str) -> None:
    with both[0].connected() as board:
        board.load("camera", "default")
    names = {"cm": cm, "D": both[0].runtime, "E": reached(both[0], "tcp")["endpoint"]}
    with eval(CHAINS[chain], names) as frames:  # the temporary is what is tried
        for _ in range(2):
            gc.collect()
            assert frames.read().shape == (480, 640)
    del frames
    gc.collect()


def test_objects_dropped_without_close_are_closed_at_garbage_collection(both: tuple[Manager, SimBoard]) -> None:
    """In a separate process: a failure would hang, and the exit must not wait either."""
    script = f"""
import gc, cm
where = {str(both[0].runtime)!r}
cm.connect(runtime_dir=where).load("camera", "default")
gc.collect()
board = cm.connect(runtime_dir=where)
kept = [board.load_async(mode="default"), board.watch(), board.interrupts["frame_done"].events()]
kept += [board.stream("camera"), kept]
kept[3].read(timeout=60)
del board, kept
gc.collect()
left = cm.connect(runtime_dir=where).stream("camera", timeout=60)
left.read()
print("done")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr

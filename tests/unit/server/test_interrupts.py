# SPDX-License-Identifier: Apache-2.0
"""Interrupts with a status register: acknowledged in spite of leases, and masked if that is impossible."""

from __future__ import annotations

import errno
import select
import threading
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from manager_support import Rig, camera, rig

from cm.device import Root, Uio
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService
from cm.manager.errors import HeldBy, RegionBusy
from cm.manager.inputs import Window
from cm.manager.state.board_state import BoardState, RegionPhase, RegionState
from cm.manager.state.journal import ManagerState
from cm.schema import loads
from cm.server.interrupts import InterruptWatch
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite, ReleaseLease, TakeLease
from cm.wire.messages.status import ErrorInfo, Irq

NAME, STATUS = "frame_done", "irq_status"
SCOPES = ("board", "config", "region:prr0", f"registers:{STATUS}")


class HeldLoop:
    """Makes a loop's calls when the test says so."""

    def __init__(self) -> None:
        self.watched: dict[int, Callable[[], None]] = {}
        self.later: list[Callable[[], None]] = []

    def add(self, descriptor: int, call: Callable[[], None]) -> None:
        self.watched[descriptor] = call

    def remove(self, descriptor: int) -> None:
        self.watched.pop(descriptor, None)

    def call_later(self, seconds: float, call: Callable[[], None]) -> None:
        self.later.append(call)

    def serve(self, timeout: float = 60.0) -> bool:
        """Wait until something is readable and serve it; return whether anything was."""
        ready = select.select(list(self.watched), [], [], timeout)[0]
        for descriptor in ready:
            self.watched[descriptor]()
        return bool(ready)

    def pass_time(self) -> None:
        """Make the calls that are scheduled for later."""
        calls, self.later = self.later, []
        for call in calls:
            call()


class Bench:
    """The interrupts of a manager's board, and what they reported."""

    def __init__(self, made: Rig, root: Path) -> None:
        self.made, self.loop = made, HeldLoop()
        self.told: list[Irq] = []
        self.errors: list[ErrorInfo] = []
        manager: Any = made.manager
        loop: Any = self.loop
        self.interrupts = InterruptWatch(loop, Root.of(root), manager, self.told.append, self.errors.append)

    def watch(self) -> None:
        self.interrupts.watch(self.made.manager.loaded_config())


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard(arguments=["--icap-rate", "0"]) as board:
        board.control.pause("camera")
        yield board


@pytest.fixture
def bench(sim: SimBoard, tmp_path: Path) -> Iterator[Bench]:
    with rig(sim.root, tmp_path / "state", camera()) as made:
        assert made.go("default") is None
        bench = Bench(made, sim.root)
        bench.watch()
        yield bench
        bench.interrupts.close()
        sim.control.clear()


def status_of(bench: Bench) -> int:
    return bench.made.manager.registers.read((STATUS,)).values[0].value


def test_an_interrupt_comes_while_a_client_holds_a_lease(bench: Bench, sim: SimBoard) -> None:
    leases = bench.made.manager.leases
    for count, (scope, exclusive) in enumerate(product(SCOPES, (True, False)), 1):
        lease = leases.request(TakeLease(scope, exclusive, holder="anna"))
        sim.control.interrupt(NAME)
        assert bench.loop.serve()
        assert [irq.count for irq in bench.told] == list(range(1, count + 1)), scope
        assert status_of(bench) == 0
        leases.request(ReleaseLease(lease.id))
    assert not bench.errors
    assert not bench.loop.serve(0)


def test_an_acknowledgement_is_neither_published_nor_recorded(
    bench: Bench, sim: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[Any] = []
    monkeypatch.setattr(bench.made.data_plane, "registers_changed", published.append)
    bench.made.manager.flush()
    before, bench.made.fault.names = bench.made.manager.state, []
    sim.control.interrupt(NAME)
    assert bench.loop.serve()
    bench.made.manager.flush()
    assert len(bench.told) == 1
    assert bench.made.manager.state is before
    assert not published
    assert "journal.write" not in bench.made.fault.names


def test_during_a_change_the_line_stays_masked_and_the_interrupt_comes_after_it(bench: Bench, sim: SimBoard) -> None:
    reached, go_on = threading.Event(), threading.Event()

    def stop(name: str) -> None:
        if name == "icap.load":
            reached.set()
            assert go_on.wait(60)

    bench.made.fault.watch = stop
    change = bench.made.manager.submit(ChangeMode(mode="edge_detection"))
    assert reached.wait(60)
    before = bench.made.fault.names.count("uio.read")
    sim.control.interrupt(NAME)
    assert bench.loop.serve()
    for _ in range(3):
        bench.loop.pass_time()
    assert bench.made.fault.names.count("uio.read") == before, "what is being changed must not be accessed"
    assert not bench.loop.serve(0)
    assert not bench.told
    assert not bench.errors, "a change that runs is not an error"
    go_on.set()
    assert change.wait(60)
    assert change.error is None
    sim.control.interrupt(NAME)  # the load has reset the flag: the device raises it anew, on a line that is masked
    bench.watch()
    assert [irq.count for irq in bench.told] == [1]
    assert status_of(bench) == 0


def test_a_line_that_cannot_be_acknowledged_is_reported_once_and_tried_again(bench: Bench, sim: SimBoard) -> None:
    bench.made.arm(0, times=3)  # each attempt reads the register, and fails
    sim.control.interrupt(NAME)
    assert bench.loop.serve()
    for _ in range(2):
        assert not bench.loop.serve(0), "it is masked"
        assert not bench.told
        bench.loop.pass_time()
    assert [error.code for error in bench.errors] == ["device_error"]
    said = f"interrupt {NAME} is masked until it can be acknowledged: "
    assert bench.errors[0].message[: len(said)] == said
    bench.loop.pass_time()
    assert [irq.count for irq in bench.told] == [1]
    assert status_of(bench) == 0
    sim.control.interrupt(NAME)
    assert bench.loop.serve()
    assert [irq.count for irq in bench.told] == [1, 2]
    assert len(bench.errors) == 1


def test_a_line_whose_device_went_is_looked_for_again(
    bench: Bench, sim: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a device of an overlay is removed with it, and appears with the next one."""

    def gone(_: Uio) -> int:
        raise OSError(errno.EIO, "the device went")

    with monkeypatch.context() as patched:
        patched.setattr(Uio, "take", gone)
        sim.control.interrupt(NAME)
        assert bench.loop.serve()
    assert bench.interrupts.incomplete
    bench.loop.pass_time()
    assert not bench.interrupts.incomplete
    bench.told.clear()
    sim.control.interrupt(NAME)
    assert bench.loop.serve()
    assert [irq.name for irq in bench.told][-1:] == [NAME]


def test_the_next_trouble_of_a_line_is_reported_again(bench: Bench, sim: SimBoard) -> None:
    for times in (1, 2):
        bench.made.arm(0)
        sim.control.interrupt(NAME)
        assert bench.loop.serve()
        bench.loop.pass_time()
        assert len(bench.told) == len(bench.errors) == times


# ---- below the lines: the register itself ---------------------------------------------

SHARED = """
config:
  name: shared
  type: partial
  modules: {a: {region: prr0}}
  regions: {prr0: {}}
  mmio:
    - base_address: 0x1000
      registers:
        plain: {offset: 0}
    - base_address: 0x2000
      region: prr0
      registers:
        flags: {offset: 0}
        cleared: {offset: 4, access: w1c}
  interrupts:
    one: {base_address: 0x2000, status: flags, bit: 0, acknowledge: true}
    two: {base_address: 0x2000, status: flags, bit: 1, acknowledge: true}
    three: {base_address: 0x2000, status: cleared, bit: 2, acknowledge: true}
    four: {base_address: 0x1000, status: plain, bit: 0, acknowledge: true}
    five: {base_address: 0x1000, status: plain, bit: 3, acknowledge: true}
  modes: {only: {modules: [a]}}
"""


class Cells:
    """Registers by address, and a list of those written."""

    def __init__(self, cells: Mapping[int, int]) -> None:
        self.cells, self.reads, self.writes = dict(cells), 0, []  # type: ignore[var-annotated]

    def window(self, address: int, width: int) -> Window:
        uio: Any = self
        return Window(uio, 0, address)

    def read(self, offset: int, width: int = 32, number: int = 0) -> int:
        self.reads += 1
        return self.cells[offset]

    def write(self, offset: int, value: int, width: int = 32, number: int = 0) -> None:
        self.writes.append((offset, value))


def held(phase: RegionPhase) -> ManagerState:
    """A state with a region in a phase of the test's choice."""
    journal: Any = None  # recording an acknowledgement would fail here
    state = ManagerState({"shared": loads(SHARED)}, journal)
    state.update(lambda _: BoardState("shared", "only", regions={"prr0": RegionState(phase)}))
    return state


class Clock:
    def monotonic(self) -> float:
        return 0.0


def registers(cells: Cells, state: ManagerState) -> RegisterService:
    devices: Any = cells
    return RegisterService(state, RegisterBus(devices), Leases(Clock()))


def service_of(cells: Cells, phase: RegionPhase = RegionPhase.READY) -> RegisterService:
    return registers(cells, held(phase))


@pytest.mark.parametrize("phase", list(RegionPhase))
def test_a_flag_is_acknowledged_only_where_the_region_answers(phase: RegionPhase) -> None:
    cells = Cells({0x2004: 4})
    if phase is RegionPhase.READY:
        assert service_of(cells, phase).take_flags("cleared", 4) == 4
        assert cells.writes == [(0x2004, 4)]
        return
    with pytest.raises(RegionBusy, match=phase.value):
        service_of(cells, phase).take_flags("cleared", 4)
    assert (cells.reads, cells.writes) == (0, [])


@pytest.mark.parametrize("phase", list(RegionPhase))
def test_a_flag_of_the_static_part_is_acknowledged_whatever_a_region_is_in(phase: RegionPhase) -> None:
    cells = Cells({0x1000: 1})
    assert service_of(cells, phase).take_flags("plain", 1) == 1
    assert cells.writes == [(0x1000, 1)]


def test_nothing_is_acknowledged_while_the_whole_device_is_loaded() -> None:
    cells = Cells({0x1000: 1})
    state = held(RegionPhase.READY)
    service = registers(cells, state)
    state.lock_regions(frozenset(), whole=True)
    with pytest.raises(RegionBusy):
        service.take_flags("plain", 1)
    assert (cells.reads, cells.writes) == (0, [])


def test_only_flags_that_stand_are_written_and_those_of_others_are_left() -> None:
    cells = Cells({0x2000: 0b1011, 0x2004: 0b0011})
    assert service_of(cells).take_flags("flags", 0b01) == 0b1011
    assert cells.writes == [(0x2000, 0b1001)], "bit 3 keeps what is written; bit 1 is another interrupt's flag"
    assert service_of(cells).take_flags("cleared", 0b100) == 0b0011
    assert len(cells.writes) == 1


def test_a_clients_write_is_still_refused_during_anothers_lease(bench: Bench) -> None:
    bench.made.manager.leases.request(TakeLease(f"registers:{STATUS}", holder="anna"))
    with pytest.raises(HeldBy, match="held by anna"):
        bench.made.manager.write_registers((RegWrite(STATUS, 1),))

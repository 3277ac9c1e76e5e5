# SPDX-License-Identifier: Apache-2.0
"""Changes of every kind: each operation fails, each fails for good, and the manager dies at each of them.

Whatever the outcome, the board is in the mode that the manager states, or the manager says what is not known.
"""

from __future__ import annotations

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from manager_process import until
from manager_support import Rig, killed_at, make_rig, place_of, rig

from cm.device import DeviceError, DevicePermission, Overlays
from cm.device.errors import device_error
from cm.manager.state.journal import newest
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import RegWrite


@dataclass(frozen=True)
class Way:
    """A change from one mode to another, given as config/mode; `after` are modes to go through before it."""

    start: str
    goal: str
    after: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.start} to {self.goal}"


TWO_REGIONS = Way("duo/default", "duo/both")
TO_FULL = Way("duo/default", "whole/full", after=("ported/only",))
TO_PORTED = Way("duo/default", "ported/only", after=("whole/full",))
TO_PARTIAL = Way("whole/full", "duo/default")
ONE_OF_TWO = Way("duo/other", "duo/both", after=("duo/default",))  # the mode before leaves prr1 alone
BY_OVERLAY = Way("kernel/default", "kernel/both")
BY_MANAGER = Way("managed/default", "managed/both")
UNLOADED = Way("duo/both", "duo/-*")
ONE_UNLOADED = Way("kernel/both", "kernel/-prr1")
REGISTERS = {"gain": 0x2000 + 0x1010, "depth": 0x6000 + 0x1010}  # of prr0 and prr1
WAYS = (TWO_REGIONS, ONE_OF_TWO, TO_FULL, TO_PARTIAL, BY_OVERLAY, BY_MANAGER, UNLOADED, ONE_UNLOADED)


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started
        sim.control.clear()


def go(made: Rig, place: str) -> object:
    config, _, mode = place.partition("/")
    return made.go(mode, config=config)


def begin(made: Rig, way: Way) -> None:
    made.arm(-1)
    for place in (*way.after, way.start):
        assert go(made, place) is None


def where(made: Rig, sim: SimBoard, configs: dict[str, Config]) -> str:
    """The mode the board is in; what is not whole is told."""
    place, status = place_of(made, sim, configs), made.manager.status()
    failed = [region.name for region in status.regions if region.state == "failed"]
    assert not made.manager.state.static_lost or status.last_error
    assert not failed or (status.last_error and all(name in status.last_error.message for name in failed))
    return place


def loads(names: list[str]) -> int:
    """The number of loads, counted by the ports."""
    return names.count("icap.load") + names.count("fpga_manager.load")


def assert_whole_regions(made: Rig) -> None:
    """Check that regions that a mode does not name are intact too, if they ever were."""
    regions = made.manager.status().regions
    assert made.manager.state.static_config or {r.state for r in regions} == {"ready"}, regions


def operations(made: Rig, way: Way) -> int:
    """How many operations the change takes."""
    begin(made, way)
    made.arm(-1)
    assert go(made, way.goal) is None
    return len(made.fault.names)


@pytest.mark.parametrize("way", WAYS, ids=str)
def test_one_failure_of_any_operation_ends_in_the_old_mode_or_the_new(
    made: Rig, sim: SimBoard, configs: dict[str, Config], way: Way
) -> None:
    ends, end = set(), ""
    for number in range(operations(made, way)):
        if end != way.start:
            begin(made, way)
        made.arm(number)
        error = go(made, way.goal)
        if number >= len(made.fault.names):  # fewer than the first time: something it polls was ready sooner
            assert error is None
            break
        name = made.fault.names[number]
        made.arm(-1)
        end = where(made, sim, configs)
        ends.add(end)
        assert end in (way.start, way.goal), f"operation {number}, {name}: {error}"
        if end == way.start or way not in (UNLOADED, ONE_UNLOADED):
            assert_whole_regions(made)
        if way in (TWO_REGIONS, ONE_OF_TWO, BY_MANAGER) and error is not None:
            there, back = loads(made.fault.names[: number + 1]), loads(made.fault.names[number + 1 :])
            assert back == there, f"operation {number}, {name}: {there} loads were begun, the way back did {back}"
        assert (error is None) == (end == way.goal), f"operation {number}, {name}: {error}"
    assert way.start in ends


@pytest.mark.parametrize("way", [TWO_REGIONS, TO_FULL, BY_OVERLAY, UNLOADED], ids=str)
def test_after_persistent_failures_the_status_says_what_is_known_of_the_board(
    made: Rig, sim: SimBoard, configs: dict[str, Config], way: Way
) -> None:
    for number in range(0, operations(made, way), 2):
        begin(made, way)
        made.arm(number, times=10_000)
        error = go(made, way.goal)
        made.arm(-1)
        if error is None:  # only the record of the end failed
            assert where(made, sim, configs) == way.goal
            continue
        status = made.manager.status()
        assert (status.pr_mode.value == "idle") == error.message.endswith("; nothing was touched")
        assert status.last_error is not None
        assert "in no mode" not in error.message or made.manager.state.mode is None
        place_of(made, sim, configs)


@pytest.mark.parametrize(
    ("way", "operation"),
    [
        (BY_MANAGER, "fpga_manager.load"),
        (BY_OVERLAY, "overlays.apply"),
        (BY_OVERLAY, "overlays.remove"),
        (TWO_REGIONS, "icap.load"),
        (TWO_REGIONS, "uio.write"),
    ],
    ids=str,
)
def test_a_change_that_the_system_does_not_permit_is_undone_and_reported(
    made: Rig, sim: SimBoard, configs: dict[str, Config], way: Way, operation: str
) -> None:
    begin(made, way)

    refused: list[str] = []

    def refuse(name: str) -> None:
        if name == operation and not refused:
            refused.append(name)
            raise device_error(errno.EACCES, "opening", "/sys/of/the/test")

    made.fault.watch = refuse
    made.arm(-1)
    config, _, mode = way.goal.partition("/")
    error = made.go(mode, config=config)
    assert error is not None
    assert error.code == "device_permission"
    assert "/sys/of/the/test" in error.message
    assert where(made, sim, configs) == way.start


def test_a_manager_that_may_not_look_at_the_board_does_not_start(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise it would take the board for an empty one."""
    begin(made, TWO_REGIONS)
    made.close()

    def refuses(_: Overlays) -> list[str]:
        raise device_error(errno.EACCES, "listing", "/sys/kernel/config/device-tree/overlays")

    before = newest((tmp_path / "journal").read_bytes())
    with monkeypatch.context() as patch:
        patch.setattr(Overlays, "list", refuses)
        blind = make_rig(sim.root, tmp_path, *configs.values())
        with pytest.raises(DevicePermission, match="device-tree/overlays"):
            blind.manager.start()
        blind.close()
    assert newest((tmp_path / "journal").read_bytes()) == before
    with rig(sim.root, tmp_path, *configs.values()) as again:
        assert where(again, sim, configs) == TWO_REGIONS.start
        assert again.notes == ()


def test_a_region_that_was_only_cut_off_is_written_its_registers_again(made: Rig, sim: SimBoard) -> None:
    """A static part may hold a region in reset while it is cut off."""
    begin(made, TWO_REGIONS)
    made.manager.write_registers((RegWrite("gain", 9), RegWrite("depth", 8)))
    refused: list[str] = []
    reset: list[str] = []

    def watch(name: str) -> None:
        if name == "icap.allocate" and not refused:  # both regions are cut off, nothing was loaded
            refused.append(name)
            raise DeviceError(errno.ENOMEM, "no memory for DMA")
        if refused and not reset and not any(r["decoupled"] for r in sim.control.state()["regions"].values()):
            reset.append(name)
            for register in ("gain", "depth"):
                window = made.devices.window(REGISTERS[register], 32)
                window.device.write(window.offset, 0, 32, window.map)

    made.arm(-1)
    made.fault.watch = watch
    assert go(made, TWO_REGIONS.goal) is not None
    assert reset == ["uio.read"]  # behind the last decoupler, before the registers
    assert loads(made.fault.names) == 0
    assert [v.value for v in made.manager.registers.read(("gain", "depth")).values] == [9, 8]


def test_register_values_that_are_recorded_during_a_change_do_not_hide_it(made: Rig, tmp_path: Path) -> None:
    """Otherwise a kill after that would leave new modules in what is taken for the old mode."""
    begin(made, TWO_REGIONS)
    found = []

    def request(name: str) -> None:
        if name == "icap.load":
            made.manager.write_registers((RegWrite("led", 2),))
            made.manager.flush()
            found.append(newest((tmp_path / "journal").read_bytes()))

    made.arm(-1)
    made.fault.watch = request
    assert go(made, TWO_REGIONS.goal) is None
    made.fault.watch = lambda _: None
    assert len(found) == 2
    assert found[0] is not None
    assert found[0].pending is not None
    assert (found[0].pending.step, found[0].pending.mode) == ("load", "both")
    assert found[0].state.values["led"] == 2
    last = newest((tmp_path / "journal").read_bytes())
    assert last is not None
    assert last.pending is None


@pytest.mark.parametrize(
    ("way", "stride"), [(TWO_REGIONS, 1), (TO_FULL, 1), (TO_PARTIAL, 4), (BY_OVERLAY, 4), (UNLOADED, 1)], ids=str
)
def test_a_manager_killed_at_any_operation_comes_back_knowing(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, way: Way, stride: int
) -> None:
    ends: dict[str, int] = {}
    with rig(sim.root, tmp_path, *configs.values()) as first:
        begin(first, way)
    number = 0
    config, _, mode = way.goal.partition("/")
    loaded = sim.control.state()["loads"]
    while killed_at(sim.root, tmp_path, configs.values(), (config, mode), number):
        forth = sim.control.state()["loads"] - loaded
        with rig(sim.root, tmp_path, *configs.values()) as again:
            again.manager.wait_idle()
            end = where(again, sim, configs)
            back = sim.control.state()["loads"] - loaded - forth
            assert way is not TWO_REGIONS or back <= forth + 1, (
                f"killed at operation {number} after {forth} loads, {back} to repair it"
            )
            ends[end] = ends.get(end, 0) + 1
            assert end in (way.start, way.goal), f"killed at operation {number}: {again.notes}"
            if end != way.start:
                begin(again, way)
        loaded = sim.control.state()["loads"]
        number += stride
    assert number > 12
    assert way.start in ends


@pytest.mark.parametrize(
    ("way", "fault", "target", "code"),
    [
        (TWO_REGIONS, "icap_crc", "", "load_failed"),
        (TWO_REGIONS, "icap_id", "", "load_failed"),
        (TWO_REGIONS, "icap_hang", "", "load_failed"),
        (TO_PORTED, "icap_hang", "", "load_failed"),
        (TWO_REGIONS, "overlay_error", "duo_extra", "device_invalid"),
        (BY_OVERLAY, "overlay_error", "cm-prr1", "device_invalid"),
        (BY_OVERLAY, "fpga_manager_error", "", "device_error"),
        (BY_MANAGER, "fpga_manager_error", "", "device_error"),
        (TO_FULL, "fpga_manager_error", "", "device_error"),
        (TO_FULL, "overlay_error", "whole_extra", "device_invalid"),
        (TO_PORTED, "icap_crc", "", "load_failed"),
    ],
    ids=lambda value: str(value) or "any",
)
def test_a_fault_of_the_board_brings_it_back(
    made: Rig, sim: SimBoard, configs: dict[str, Config], way: Way, fault: str, target: str, code: str
) -> None:
    begin(made, way)
    sim.control.inject(fault, target or None)
    error = go(made, way.goal)
    sim.control.clear()
    assert where(made, sim, configs) == way.start
    assert error is not None
    assert error.code == code  # type: ignore[attr-defined]


@pytest.mark.parametrize("way", [TWO_REGIONS, TO_FULL, BY_OVERLAY], ids=str)
def test_nothing_leaks_over_failed_changes(made: Rig, sim: SimBoard, way: Way) -> None:
    def held() -> tuple[int, int, int, int]:
        state = sim.control.state()
        fds, overlays = len(list(Path("/proc/self/fd").iterdir())), len(state["overlays"])
        return fds, state["buffers"], state["connections"], overlays

    def fail() -> None:
        made.arm(count - 8)
        assert go(made, way.goal) is not None

    count = operations(made, way)
    begin(made, way)
    for _ in range(2):
        fail()
    before = held()
    for _ in range(6):
        fail()
    until(lambda: all(now <= was for now, was in zip(held(), before, strict=True)))  # the board ends connections later

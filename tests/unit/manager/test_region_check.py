# SPDX-License-Identifier: Apache-2.0
"""A region is compared with what was loaded into it, and repaired: a change like any other, whatever happens to it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from manager_process import until
from manager_schemas import written
from manager_support import Rig, killed_at, rig

from cm.errors import CmError
from cm.formats.bitstream import FrameRun, assemble, open_image
from cm.formats.bitstream.geometry import decode_far
from cm.formats.bitstream.idcodes import Family
from cm.manager.errors import ChangeBusy, HeldBy, NoReadback, NothingLoaded, RegionBusy, UnknownRegion
from cm.manager.execution.region_readback import Reader
from cm.manager.execution.worker import SCANS
from cm.schema.model import Config, LoaderKind
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, CheckRegion, RegWrite, TakeLease
from cm.wire.messages.status import ErrorInfo, RegionCheck, RegionHealth

FRAME = 4 * 101


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    found = written(tmp_path_factory.mktemp("configs"), ("duo", "kernel"))
    left_open = replace(found["duo"].regions["prr0"], loader=LoaderKind.AUTO)
    return found | {"duo": replace(found["duo"], regions={**found["duo"].regions, "prr0": left_open})}


@pytest.fixture(scope="module")
def started(configs: dict[str, Config]) -> Iterator[SimBoard]:
    folders = [next(iter(configs.values())).source.parent]  # type: ignore[union-attr]
    with SimBoard(folders, arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def sim(started: SimBoard) -> SimBoard:
    started.control.clear()
    started.control.reset()
    return started


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, configs["duo"], configs["kernel"]) as one:
        assert one.go("default", config="duo") is None
        one.arm(-1)
        one.data_plane.calls.clear()
        yield one


def check(made: Rig, region: str = "prr0") -> RegionCheck:
    ended: queue.SimpleQueue[RegionCheck | Exception] = queue.SimpleQueue()
    made.manager.check(made.manager.prepared_check(region), ended.put)
    result = ended.get(timeout=60)
    if isinstance(result, Exception):
        raise result
    return result


def repaired(made: Rig, **how: Any) -> RegionCheck:
    change = made.manager.repair(CheckRegion("prr0", repair=True, **how))
    assert change.wait(60)
    assert change.error is None, change.error
    assert change.checked is not None
    return change.checked


def held(sim: SimBoard, region: str = "prr0") -> str | None:
    name: str | None = sim.control.state()["regions"][region]["module"]
    return name


def gain(made: Rig) -> int:
    return made.manager.registers.read(("gain",)).values[0].value


def health(made: Rig) -> RegionHealth | None:
    """That of prr0, with 1 for the time of its last check."""
    found = next(region.health for region in made.manager.status().regions if region.name == "prr0")
    return found and replace(found, checked_ns=min(found.checked_ns, 1))


def places(result: RegionCheck) -> list[tuple[int, int]]:
    return sorted((frame.far, bit) for frame in result.wrong for bit in frame.bits)


def test_what_was_loaded_is_there(made: Rig) -> None:
    result = check(made)
    assert (result.verdict, result.module, result.wrong_bits, result.unjudged) == ("good", "a0", 0, 0)
    assert result.frames > 0
    assert 0 <= result.seconds < 60
    assert health(made) == RegionHealth(checks=1, frames=result.frames, checked_ns=1)


def test_each_upset_is_told_by_its_frame_and_bit_and_counted_once(made: Rig, sim: SimBoard) -> None:
    hits = sim.control.upset("prr0", 4)
    result = check(made)
    assert (result.verdict, places(result), result.wrong_bits) == ("wrong", sorted(hits), 4)
    assert (result.region, result.config_name, result.mode) == ("prr0", "duo", "default")
    assert result.wrong_frames == len({far for far, _ in hits}) == len(result.wrong)
    frame = result.wrong[0]
    where = decode_far(frame.far, Family.SERIES7)
    assert (frame.block_type, frame.row, frame.column, frame.minor) == (
        where.block_type,
        where.row,
        where.column,
        where.minor,
    )
    assert check(made).wrong_bits == 4
    assert check(made, "prr1").verdict == "good"
    assert health(made) == RegionHealth(checks=2, upsets=4, wrong_bits=4, frames=result.frames, checked_ns=1)


def test_the_map_of_a_region_has_what_the_last_check_has_found_until_it_is_loaded_again(
    made: Rig, sim: SimBoard
) -> None:
    assert (made.manager.region_map("prr0").wrong, made.manager.region_map("prr0").checked) == ((), 0.0)
    sim.control.upset("prr0", 4)
    wrong = check(made).wrong
    drawn = made.manager.region_map("prr0")
    assert drawn.wrong == wrong
    assert 0 < drawn.checked < 60
    assert made.manager.submit(ChangeMode("duo", "default", force=True)).wait(60)
    assert (made.manager.region_map("prr0").wrong, made.manager.region_map("prr0").checked) == ((), 0.0)


def test_wrong_frames_are_written_anew_while_everything_runs_on(made: Rig, sim: SimBoard) -> None:
    made.manager.write_registers((RegWrite("gain", 5),))
    hits = sim.control.upset("prr0", 3)
    result = repaired(made)
    assert (result.repaired, result.verdict, places(result)) == ("frames", "good", sorted(hits))
    assert check(made).verdict == "good"
    assert (held(sim), gain(made)) == ("a0", 5)
    assert not [call for call in made.data_plane.calls if call[0] == "quiesce"]
    assert made.fault.names.count("icap.load") == 1
    assert "uio.write" not in made.fault.names[made.fault.names.index("icap.load") :]
    told = health(made)
    assert told is not None
    assert (told.upsets, told.repairs, told.wrong_bits) == (3, 1, 0)


def test_a_region_that_is_loaded_again_has_its_registers_again(made: Rig, sim: SimBoard) -> None:
    made.manager.write_registers((RegWrite("gain", 5),))
    sim.control.upset("prr0")
    result = repaired(made, reload=True)
    assert (result.repaired, result.verdict) == ("load", "good")
    assert made.fault.names.count("icap.load") == 1
    assert check(made).verdict == "good"
    assert (held(sim), gain(made)) == ("a0", 5)
    assert ("quiesce", ("through0",)) in made.data_plane.calls


def test_what_is_good_is_not_touched(made: Rig) -> None:
    result = repaired(made)
    assert (result.repaired, result.verdict) == ("", "good")
    assert "icap.load" not in made.fault.names


def test_a_module_that_the_mode_does_not_name_is_repaired_too(made: Rig, sim: SimBoard) -> None:
    assert made.go("other", config="duo") is None
    sim.control.upset("prr1")
    for reload in (False, True):
        change = made.manager.repair(CheckRegion("prr1", repair=True, reload=reload))
        assert change.wait(60)
        assert change.error is None
        assert check(made, "prr1").verdict == "good"
        assert (held(sim, "prr1"), made.manager.state.mode) == ("a1", "other")
        sim.control.upset("prr1")


def test_a_hit_in_the_frame_that_is_being_written_is_found_by_the_check_after_it(made: Rig, sim: SimBoard) -> None:
    ((far, bit),) = sim.control.upset("prr0")
    reads: list[str] = []

    def hit_again(name: str) -> None:
        if name == "icap.read":
            reads.append(name)
            if len(reads) == 2:
                sim.control.upset("prr0", 1, far, bit ^ 1)

    made.fault.watch = hit_again
    assert repaired(made).repaired == "load"
    made.fault.watch = lambda _: None
    assert check(made).verdict == "good"


def test_what_is_wrong_again_each_time_is_told_and_stays_what_it_is(made: Rig, sim: SimBoard) -> None:
    def stuck(name: str) -> None:
        if name == "icap.read":
            sim.control.upset("prr0", 1, far, bit)

    ((far, bit),) = sim.control.upset("prr0")
    sim.control.upset("prr0", 1, far, bit)
    made.fault.watch = stuck
    change = made.manager.repair(CheckRegion("prr0", repair=True))
    assert change.wait(60)
    made.fault.watch = lambda _: None
    assert change.error == ErrorInfo("region_wrong", "region prr0 differs in 1 bits also after it was loaded again")
    assert made.manager.status().mode == "default"
    assert repaired(made).verdict == "good"


def test_bits_of_a_mask_beside_the_bitstream_are_not_compared_and_their_frames_not_written(
    made: Rig, sim: SimBoard
) -> None:
    ((far, bit),) = sim.control.upset("prr0")
    family = Family.SERIES7
    bitstream = made.manager.prepared_check("prr0").image.path
    mask = bytearray(FRAME)
    mask[bit // 32 * 4 + 3 - bit % 32 // 8] = 1 << bit % 8
    beside = bitstream.with_suffix(".msk")
    frames = [decode_far(one, family) for one in {far}]
    beside.write_bytes(assemble("xc7z020", [FrameRun(frames[0], bytes(mask) + bytes(FRAME))]))
    made.files._frames.clear()
    try:
        result = check(made)
        assert (result.verdict, result.frames) == ("good", 1)  # the mask has no word about the others
        assert result.unjudged > 0
        sim.control.upset("prr0", 1, far, bit ^ 8)
        assert places(check(made)) == [(far, bit ^ 8)]
        assert repaired(made).repaired == "load"
    finally:
        beside.unlink()
        made.files._frames.clear()
    assert open_image(bitstream)


NO_WAY = (
    "its configuration port can be written but not read (no CM_ICAP_CAP_READ): the design's port, its second DMA "
    "channel or this driver has no way back"
)


@pytest.mark.parametrize(
    ("arrange", "region", "wanted", "why"),
    [
        (lambda sim, made: sim.control.inject("icap_write_only"), "prr0", NoReadback, "region prr0: " + NO_WAY),
        (
            lambda sim, made: made.go("default", config="kernel"),
            "prr0",
            NoReadback,
            "region prr0 is loaded by overlay, which cannot read: loader: icap can",
        ),
        (
            lambda sim, made: None,
            "prr7",
            UnknownRegion,
            "configuration 'duo' has no region 'prr7'; did you mean 'prr1' or 'prr0'?",
        ),
    ],
    ids=["write only", "another port", "no such region"],
)
def test_what_cannot_be_compared_says_why(
    made: Rig, sim: SimBoard, arrange: Callable[..., Any], region: str, wanted: type[CmError], why: str
) -> None:
    arrange(sim, made)
    made.manager.wait_idle()
    with pytest.raises(wanted) as refused:
        check(made, region)
    assert str(refused.value) == why


def test_a_port_that_does_not_answer_is_told_and_can_be_asked_again(made: Rig, sim: SimBoard) -> None:
    sim.control.inject("icap_hang")
    with pytest.raises(NoReadback, match="the port gave 0 of"):
        check(made)
    assert check(made).verdict == "good"


def test_before_anything_is_loaded_there_is_nothing_to_compare(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    with rig(sim.root, tmp_path, configs["duo"]) as empty, pytest.raises(RegionBusy, match="nothing is loaded"):
        check(empty)


def test_a_region_of_unknown_content_is_not_compared(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> None:
    with rig(sim.root, tmp_path, configs["duo"]) as made:
        assert made.go("other", config="duo") is None
        with pytest.raises(RegionBusy, match="prr1 is unknown"):
            check(made, "prr1")


def test_a_repair_is_refused_where_there_is_no_region_to_repair(
    made: Rig, sim: SimBoard, configs: dict[str, Config], tmp_path: Path
) -> None:
    with pytest.raises(UnknownRegion) as unknown:
        made.manager.repair(CheckRegion("prr7"))
    assert str(unknown.value) == "configuration 'duo' has no region 'prr7'; did you mean 'prr1' or 'prr0'?"
    lease = made.manager.leases.request(TakeLease("region:prr0", holder="anna"))
    made.manager.repair(CheckRegion("prr1")).wait(60)
    with pytest.raises(HeldBy, match="region:prr0 is held by anna"):
        made.manager.repair(CheckRegion("prr0"))
    change = made.manager.repair(CheckRegion("prr0", lease=lease.id))
    assert change.wait(60)
    assert change.error is None
    made.close()
    with rig(sim.root, tmp_path / "new", configs["duo"]) as empty, pytest.raises(NothingLoaded) as nothing:
        empty.manager.repair(CheckRegion("prr0"))
    assert str(nothing.value) == "nothing is loaded: there is no region to compare"


def test_a_file_that_is_not_what_was_loaded_is_not_compared(made: Rig) -> None:
    path = made.manager.prepared_check("prr0").image.path
    good, other = path.read_bytes(), path.with_name("b0.bit").read_bytes()
    path.write_bytes(other)
    try:
        for look in (made.manager.prepared_check, made.manager.region_map):
            with pytest.raises(NoReadback) as refused:
                look("prr0")
            assert str(refused.value) == (
                f"region prr0: {path} is not what was loaded any more; load it, or restore the file"
            )
    finally:
        path.write_bytes(good)
    told = made.manager.region_map("prr0")
    assert (told.region, told.module, told.device, told.config_name) == ("prr0", "a0", "xc7z020", "duo")
    assert sum(len(column.bits) for column in told.columns) == check(made).frames


def test_checks_that_wait_are_bounded_and_end_with_the_manager(made: Rig) -> None:
    held, let = threading.Event(), threading.Event()

    def hold(name: str) -> None:
        held.set()
        assert let.wait(60)

    for _ in range(SCANS + 1):
        check(made)  # which do not count any more
    assert made.go("default", config="duo") is None
    what = made.manager.prepared_check("prr0")
    ended: queue.SimpleQueue[RegionCheck | Exception] = queue.SimpleQueue()
    made.fault.watch = hold
    for _ in range(SCANS):
        made.manager.check(what, ended.put)
    assert held.wait(60)
    with pytest.raises(ChangeBusy) as refused:
        made.manager.check(what, ended.put)
    assert str(refused.value) == "16 checks of regions run or wait already; try again when one has ended"
    stopper = threading.Thread(target=made.manager.stop)
    stopper.start()
    until(made.manager._worker._stopping.is_set)
    let.set()
    stopper.join(60)
    results = [ended.get(timeout=60) for _ in range(SCANS)]
    assert {str(result) for result in results if isinstance(result, Exception)} == {
        "the configuration manager is stopping"
    }


def test_a_check_in_the_background_goes_on_when_its_pace_says_so_and_tells_only_what_is_wrong(
    made: Rig, sim: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Reader, "most_frames", lambda self, size: 50)
    told: list[str] = []
    monkeypatch.setattr(made.data_plane, "status_changed", lambda: told.append(""))
    pauses: queue.SimpleQueue[tuple[float, Callable[[], None]]] = queue.SimpleQueue()
    ended: queue.SimpleQueue[RegionCheck | Exception] = queue.SimpleQueue()
    for wrong in (0, 1):
        sim.control.upset("prr0", wrong)
        told.clear()
        made.manager.check(made.manager.prepared_check("prr0"), ended.put, lambda *pause: pauses.put(pause))
        while ended.empty():
            with suppress(queue.Empty):
                seconds, go_on = pauses.get(timeout=0.1)
                assert 0 <= seconds < 60
                assert ended.empty()
                go_on()
        result = ended.get()
        assert isinstance(result, RegionCheck)
        assert (result.wrong_bits, len(told), result.config_name, result.mode) == (wrong, wrong, "duo", "default")


def test_a_change_that_comes_during_a_check_does_not_wait_for_its_end(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Reader, "most_frames", lambda self, size: 50)
    changes: list[Any] = []

    def change(name: str) -> None:
        if name == "icap.read" and not changes:
            changes.append(None)
            changes[0] = made.manager.submit(ChangeMode("duo", "lit"))

    made.fault.watch = change
    assert check(made, "prr1").verdict == "good"
    assert changes[0].wait(60)
    names = made.fault.names
    assert names[: names.index("icap.load")].count("icap.read") == 1
    assert names.count("icap.read") > 5


def test_a_region_that_is_changed_during_its_check_is_not_judged(made: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Reader, "most_frames", lambda self, size: 50)
    changes: list[Any] = []

    def change(name: str) -> None:
        if name == "icap.read" and not changes:
            changes.append(made.manager.submit(ChangeMode("duo", "other")))

    made.fault.watch = change
    with pytest.raises(RegionBusy, match="changed while it was compared"):
        check(made)
    assert changes[0].wait(60)


@pytest.mark.parametrize("reload", [False, True], ids=["frames", "load"])
def test_a_repair_that_fails_at_any_operation_leaves_the_board_in_its_mode(
    made: Rig, sim: SimBoard, reload: bool
) -> None:
    made.manager.write_registers((RegWrite("gain", 5),))
    sim.control.upset("prr0")
    made.arm(-1)
    repaired(made, reload=reload)
    for number in range(len(made.fault.names)):
        sim.control.upset("prr0")
        made.arm(number)
        change = made.manager.repair(CheckRegion("prr0", repair=True, reload=reload))
        assert change.wait(60)
        made.arm(-1)
        told = made.manager.status()
        assert (told.config_name, told.mode) == ("duo", "default"), f"operation {number}"
        assert repaired(made).verdict == "good", f"operation {number}"
        assert (held(sim), gain(made)) == ("a0", 5), f"operation {number}"


@pytest.mark.parametrize("reload", [False, True], ids=["frames", "load"])
def test_a_manager_that_is_killed_at_any_operation_of_a_repair_knows_what_there_is(
    sim: SimBoard, configs: dict[str, Config], tmp_path: Path, reload: bool
) -> None:
    number, survived = 0, False
    while not survived:
        state = tmp_path / str(number)
        with rig(sim.root, state, configs["duo"]) as first:
            assert first.go("default", config="duo") is None
            first.manager.write_registers((RegWrite("gain", 5),))
        sim.control.upset("prr0")
        request = CheckRegion("prr0", repair=True, reload=reload)
        survived = not killed_at(sim.root, state, [configs["duo"]], request, number)
        with rig(sim.root, state, configs["duo"]) as again:
            again.manager.wait_idle()
            told = again.manager.status()
            assert (told.config_name, told.mode, told.regions[0].state) == ("duo", "default", "ready"), number
            assert (held(sim), gain(again)) == ("a0", 5), f"operation {number}"
            assert repaired(again).verdict == "good", f"operation {number}"
        number += 1
    assert number > 5

# SPDX-License-Identifier: Apache-2.0
"""Why a board is as it is: sentences that name causes, and say what is not known."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_schemas import written
from manager_support import Rig, rig

from cm.errors import NotFound
from cm.frozen import replace
from cm.recording.story import Story, of_manager
from cm.recording.why import explain, fault
from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, RegWrite
from cm.wire.messages.status import (
    ConfigInfo,
    ErrorInfo,
    PastChange,
    PastWrite,
    RegionHealth,
    RegionStatus,
    RegisterInfo,
    Status,
    StepTaken,
    StreamClient,
    StreamStatus,
)

ANNA = "anna (uid 1001, pid 811)"
S = 1_000_000_000
STEPS = (
    StepTaken("decouple", "prr0", 10 * S, 0.001),
    StepTaken("load", "prr0", 10 * S + 1_000_000, 0.021, 0.02),
    StepTaken("recouple", "prr0", 10 * S + 22_000_000, 0.0004),
    StepTaken("registers", "threshold", 10 * S + 23_000_000, 0.0001),
)
EDGE = PastChange(2, "camera", "edge", "camera", "default", ANNA, "", 10 * S, 10 * S + 25_000_000, None, STEPS)
CONFIG = ConfigInfo(
    "camera",
    registers=tuple(RegisterInfo(n, 0, 32, "rw", region="prr0") for n in ("focus", "threshold")),
)  # fmt: skip
STATUS = Status(
    "camera", "edge", board="bench", regions=(RegionStatus("prr0", "edge", "ready", health=RegionHealth(5, 2, 1)),)
)


def story(status: Status = STATUS, **parts: object) -> Story:
    given: dict[str, object] = {"config": CONFIG, "changes": (EDGE,), **parts}
    return Story(status, 0, 5 * S, 20 * S, **given)  # type: ignore[arg-type]


def test_a_region_is_explained_by_the_change_that_loaded_it_and_by_what_came_after() -> None:
    writes = (PastWrite("focus", 5, "pid 811", 12 * S), PastWrite("threshold", 9, "too early", 9 * S))
    (line,) = explain(story(writes=writes), "prr0")
    for part in (
        "prr0 holds edge since", f"change 2, asked for by {ANNA}", "the load took 21 ms, 20 ms of it the port",
        "it was decoupled for 21.4 ms", "focus=0x5 was written at", "by pid 811", "2 upset bits", "1 repairs",
    ):  # fmt: skip
        assert part in line
    assert "too early" not in line
    for ms, said in ((400, "400 ms"), (999.6, "1.0 s"), (2040, "2.0 s")):  # without exponents
        (line, *_) = explain(story(changes=(replace(EDGE, ended_ns=10 * S + round(ms * 1e6)),)))
        assert f"; it took {said}." in line


def test_a_region_that_was_unloaded_is_explained_by_the_change_that_did_it() -> None:
    steps = (StepTaken("decouple", "prr0", 12 * S, 0.001), StepTaken("publish", "camera/no mode", 12 * S, 0.001))
    why = "to unload prr0"
    change = PastChange(3, "camera", "", "camera", "edge", ANNA, why, 12 * S, 13 * S, None, steps)
    status = Status("camera", board="bench", regions=(RegionStatus("prr0", None, "decoupled"),))
    unloaded = story(status, changes=(EDGE, change))
    assert explain(unloaded)[0].startswith("bench is in no mode of camera since")
    for line in (explain(unloaded)[0], *explain(unloaded, "prr0")):
        assert f"asked for by {ANNA}, {why}" in line
    assert explain(unloaded, "prr0")[0].startswith("prr0 is empty since")
    assert "when prr0 was unloaded: change 3" in explain(unloaded, "focus")[0]


def test_what_is_not_recorded_is_not_known() -> None:
    whole = "\n".join(explain(story(changes=())))
    assert "since when and why is not known" in whole
    assert "before this manager began" in whole
    assert explain(story(changes=()), "focus") == [
        line for line in explain(story(changes=()), "focus") if "Who wrote focus, and when, is not known" in line
    ]
    with pytest.raises(NotFound, match="there is no region, register or stream 'nix'; there are prr0, focus"):
        explain(story(), "nix")


@pytest.mark.parametrize(
    ("at", "said"), [(0, "threshold was set at"), (9 * S, "threshold was set at"), (11 * S, "was written at")]
)
def test_a_register_is_explained_by_what_came_last(at: int, said: str) -> None:
    writes = (PastWrite("threshold", 9, ANNA, at),) if at else ()
    (line,) = explain(story(writes=writes), "threshold")
    assert said in line
    assert ANNA in line


def test_a_register_whose_region_was_loaded_since_was_reset() -> None:
    (line,) = explain(story(writes=(PastWrite("focus", 5, "bert", 9 * S),)), "focus")
    assert "focus was reset at" in line
    assert ANNA in line


def test_a_stream_is_explained_by_who_holds_it_up() -> None:
    slow = StreamClient(5, "slow", depth=4, held=4, dropped=12)
    error = ErrorInfo("dma_error", "the channel stopped")
    status = Status(streams=(StreamStatus("camera", "c", "s2mm", dropped=12, clients=(slow,), last_error=error),))
    (line,) = explain(story(status), "camera")
    assert "pid 5 (slow) lost 12: it holds 4 of the 4" in line
    assert "when is not known: the channel stopped [dma_error]" in line


# ---- the walk through all faults: as in tests/unit/manager/test_manager_walk.py -----------------


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    return written(tmp_path_factory.mktemp("schemas"), ("duo", "kernel", "managed"))


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    paths = [config.source for config in configs.values() if config.source]
    with SimBoard(paths, arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started
        sim.control.clear()


def now(made: Rig) -> Story:
    history = made.manager.reporter.history
    status = made.manager.status(changes=history.changes(), writes=history.writes())
    return of_manager(status, ConfigInfo(), 0)


def go(made: Rig, config: str, mode: str) -> ErrorInfo | None:
    change = made.manager.submit(ChangeMode(config, mode), by=ANNA)
    assert change.wait(30)
    return change.error


@pytest.mark.parametrize("config", ["duo", "kernel"])
def test_each_fault_of_the_walk_is_explained_by_one_line_that_names_its_cause(made: Rig, config: str) -> None:
    assert go(made, config, "default") is None
    made.arm(-1)
    assert go(made, config, "both") is None
    count, explained = len(made.fault.names), 0
    for number in range(count):
        made.arm(-1)
        assert go(made, config, "default") is None
        assert fault(now(made)) == ""
        made.arm(number)
        error = go(made, config, "both")
        if number >= len(made.fault.names):
            break
        name = made.fault.names[number]
        made.arm(-1)
        line = fault(now(made))
        if error is None:  # nothing that the change needed
            assert line == "" or f"injected at {name}" in line
            continue
        explained += 1
        assert f"injected at {name}" in line, (name, line)
        assert f"asked for by {ANNA}" in line
        assert f"Change {made.manager.status().last_change} to {config}/both failed" in line
        assert line in explain(now(made))
    assert explained > count // 2


@pytest.mark.parametrize(
    ("config", "kind", "target", "step"),
    [
        ("duo", "icap_crc", "", "load prr0"), ("duo", "icap_id", "", "load prr0"),
        ("duo", "icap_hang", "", "load prr0"),
        ("duo", "overlay_error", "duo_extra", "overlay_apply duo_extra"),
        ("kernel", "overlay_error", "cm-prr1", "load prr1"), ("kernel", "fpga_manager_error", "", "load prr0"),
        ("managed", "fpga_manager_error", "", "load prr0"), ("duo", "register_stuck", "gain", "registers gain"),
    ],
)  # fmt: skip
def test_a_fault_of_the_board_is_explained_by_the_step_that_it_struck(
    made: Rig, sim: SimBoard, config: str, kind: str, target: str, step: str
) -> None:
    assert go(made, config, "default") is None
    if kind == "register_stuck":
        made.manager.write_registers((RegWrite("gain", 9),))
    sim.control.inject(kind, target or None)
    error = go(made, config, "both")
    sim.control.clear()
    assert error is not None
    line = fault(now(made))
    assert f"at step {step}" in line
    assert error.message in line

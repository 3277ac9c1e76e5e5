# SPDX-License-Identifier: Apache-2.0
"""After the machine slept nothing is assumed about the PL's contents: it may have lost power."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_support import Rig, rig

from cm.schema.model import Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.status import ErrorInfo


@pytest.fixture
def made(sim: SimBoard, configs: dict[str, Config], tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path / "state", *configs.values()) as started:
        yield started
        sim.control.clear()


def slept(made: Rig) -> list[str]:
    """Sleep, and return what was done to the board afterwards."""
    made.arm(-1)
    made.manager.board_slept()
    made.manager.wait_idle()
    return made.fault.names


def test_every_region_of_the_mode_is_loaded_again(made: Rig) -> None:
    assert made.go("both", config="duo") is None
    made.manager.board_slept()
    assert made.manager.status().last_error == ErrorInfo("slept", "the machine slept: what the PL held is loaded again")
    made.manager.wait_idle()
    assert slept(made).count("icap.load") == 2
    state = made.manager.state
    assert (state.config, state.mode) == ("duo", "both")
    assert {region.phase.value for region in state.regions.values()} == {"ready"}


@pytest.mark.parametrize(("config", "mode"), [("whole", "full"), ("duo", "both")])
def test_an_image_of_the_whole_device_is_loaded_again_before_anything_is_accessed(
    made: Rig, config: str, mode: str
) -> None:
    assert made.go("default", config="whole") is None
    assert made.go(mode, config=config) is None
    done = slept(made)
    assert not [name for name in done[: done.index("fpga_manager.load")] if name.startswith("uio")]
    assert done.count("icap.load") == 2
    state = made.manager.state
    assert (state.config, state.mode, state.static_config, state.static_lost) == (config, mode, "whole", False)


def test_nothing_is_claimed_until_the_load_has_ended(made: Rig) -> None:
    assert made.go("both", config="duo") is None
    seen: list[set[str]] = []
    made.arm(-1)
    made.fault.watch = lambda _: seen.append({r.phase.value for r in made.manager.state.regions.values()})
    made.manager.board_slept()
    made.manager.wait_idle()
    assert seen
    assert "ready" not in seen[0]
    record = made.journal.read()
    assert record is not None
    assert record.state.mode == "both"


def test_a_load_that_fails_after_a_sleep_leaves_no_claim(made: Rig) -> None:
    assert made.go("both", config="duo") is None
    made.arm(-1)
    made.fault.watch = lambda name: made.arm(0, times=1000) if name == "icap.load" else None
    made.manager.board_slept()
    made.manager.wait_idle()
    made.fault.watch = lambda _: None
    made.arm(-1)
    assert "ready" not in {r.phase.value for r in made.manager.state.regions.values()}


def test_a_board_that_holds_nothing_stays_as_it_is(made: Rig) -> None:
    assert slept(made) == ["journal.write"]
    assert made.manager.state.config is None
    made.fault.make = lambda _: OSError(28, "full")
    made.arm(0)
    made.manager.board_slept()
    assert made.manager.status().last_error == ErrorInfo("store", "the state record could not be written: full")

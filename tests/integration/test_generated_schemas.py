# SPDX-License-Identifier: Apache-2.0
"""Schemas of `cm build generate` and `cm build collect`, loaded by a manager and run on the simulated board."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from manager_process import Manager, short_folder, until

import cm
from cm.simulation.software import Board as SimBoard

sys.path.append(str(Path(__file__).parents[1] / "unit"))

from build_support import NAMES, copy_examples, generated

pytestmark = pytest.mark.design


@contextlib.contextmanager
def running(config: Path, *arguments: str) -> Iterator[cm.Board]:
    """A client of a manager on a board with these configurations; `arguments`: for the simulator."""
    with short_folder() as folder, SimBoard([config], root=folder / "board", arguments=arguments) as sim:
        state = str(folder / "state")
        manager = Manager(folder / "run", "--config", str(config), "--root", str(sim.root), "--state-dir", state)
        manager.start()
        try:
            with manager.connected() as board:
                yield board
        finally:
            manager.stop()


@pytest.mark.parametrize("name", NAMES)
def test_every_mode_of_a_generated_schema_can_be_entered(name: str, tmp_path: Path) -> None:
    design, out = generated(copy_examples(tmp_path), name)
    with running(out / "config") as board:
        board.load(name)
        assert board.mode == design.project.default_mode
        for mode in (*design.project.modes, design.project.default_mode):
            board.mode = mode
            assert board.mode == mode
            values = design.project.modes[mode].registers
            assert {register: board.registers[register] for register in values} == dict(values)


@pytest.mark.parametrize("name", NAMES)
def test_modules_are_not_loaded_into_another_static_part(name: str, tmp_path: Path) -> None:
    _, out = generated(copy_examples(tmp_path), name)
    with running(out / "config", "--static-identity", "0x1234") as board:
        with pytest.raises(cm.CmError, match=r"expected 0x[0-9a-f]+, the board has 0x1234") as refused:
            board.load(name)
        assert refused.value.code == "wrong_static"
        assert not any(region.module for region in board.status.regions)


def test_frames_come_through_every_mode_of_the_generated_camera(tmp_path: Path) -> None:
    """The camera's grey pictures pass through the module; in the mode that colours them, with three bytes a pixel."""
    _, out = generated(copy_examples(tmp_path), "camera")
    with running(out / "config") as board:
        board.load("camera", "default")
        with board.stream("camera", timeout=60) as stream:
            for mode, shape in (("default", (480, 640)), ("edge_detection", (480, 640)), ("colorise", (480, 640, 3))):
                board.mode = mode
                frame = next(frame for frame in stream if frame.info.mode == mode)
                assert frame.shape == shape
        until(lambda: board.registers["frame_count"] > 0)  # counted behind the frame's last word

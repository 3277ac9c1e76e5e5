# SPDX-License-Identifier: Apache-2.0
"""Schemas are replaced, managers killed, boards kept or lost, in any order: a status says what is so, or "unknown"."""

from __future__ import annotations

import random
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from manager_process import CAMERA, Manager, environment, short_folder, until

import cm
from cm.errors import CmError
from cm.simulation.software import Board as SimBoard

TEXT = (CAMERA / "camera.yaml").read_text(encoding="utf-8")
MODES = ("default", "edge_detection", "colorise", "loopback", "loopback_edge")
PLACES = {"led": 0x18, "scratch": 0x14}  # offsets that builds swap


class Design:
    """A schema and its bitstreams, built anew again and again: builds differ in their day, and in two offsets."""

    def __init__(self, folder: Path, made: Path) -> None:
        self.folder = folder
        self._made = {path.name: path.read_bytes() for path in made.iterdir() if path.suffix in (".bit", ".dtbo")}
        self.number = 0
        self.build()

    def build(self) -> None:
        """The next build, in the place of the one before."""
        self.number += 1
        for name, data in self._made.items():
            day = b"2024/%02d/%02d" % (self.number // 28 % 12 + 1, self.number % 28 + 1)
            (self.folder / name).write_bytes(data.replace(b"2024/01/01", day))
        swapped = dict(zip(PLACES, [*PLACES.values()][:: -1 if self.number % 2 else 1], strict=True))
        text = TEXT.replace("doc: A camera", f"doc: Build {self.number} of a camera", 1)
        for name, offset in swapped.items():
            text, found = re.subn(rf"(\n +{name}:\n +offset: )0x[0-9a-f]+", rf"\g<1>{offset:#x}", text)
            assert found == 1, name
        (self.folder / "camera.yaml").write_text(text, encoding="utf-8")


def told_wrong(design: Design, loaded: dict[str, int], sim: SimBoard, status: Any) -> list[str]:
    """Where a status at rest, or the schema that registers are offered by, is of another build than the board's."""
    held = sim.control.state()["regions"]
    wrong = []
    for region in status.regions:
        if region.state == "decoupled" and not held[region.name]["decoupled"]:
            wrong.append(f"{region.name} is decoupled, it holds {held[region.name]}")
        if region.state == "ready":
            if (held[region.name]["module"], held[region.name]["decoupled"]) != (region.module, False):
                wrong.append(f"{region.name} is {region.module}, it holds {held[region.name]}")
            if status.config_name and loaded.get(region.name) != design.number:
                wrong.append(f"{region.name} holds build {loaded.get(region.name)}, the schema is {design.number}")
    return wrong


@pytest.mark.timeout(7200)
def test_whatever_is_replaced_killed_or_lost_a_status_says_what_the_board_holds(
    request: pytest.FixtureRequest,
) -> None:
    draw, rounds = random.Random(47), request.config.getoption("--builds")
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board", arguments=["--icap-rate", "0"]) as sim:
        (folder / "design").mkdir()
        design = Design(folder / "design", sim.root / "lib/firmware/cm/camera")
        places = ("--config", str(design.folder), "--root", str(sim.root), "--state-dir", str(folder / "state"))
        manager = Manager(folder / "run", *places, env=environment()).start()
        loaded: dict[str, int] = {}  # builds that regions hold, by what was confirmed
        for number in range(rounds):
            deeds = [
                draw.choice(("build", "kill", "stop", "lose", "load", "force", "load", "unload")) for _ in range(4)
            ]
            for deed in deeds:
                with manager.connected() as board:
                    do(deed, draw, manager, sim, design, board, loaded)
            manager.kill()
            manager.start()
            with manager.connected() as board:
                until(lambda: not board.status.fpga_busy)
                status = board.status
                note_loads(design, loaded, status)
                assert told_wrong(design, loaded, sim, status) == [], f"round {number}: {deeds}"
                if status.config_name:
                    board.registers["led"] = number % 256
                    assert board.registers["led"] == number % 256
                else:
                    with pytest.raises(CmError):
                        board.registers["led"] = 1
        assert manager.stop() == 0


def note_loads(design: Design, loaded: dict[str, int], status: Any) -> None:
    """What a start has loaded itself, to bring the board back, it has loaded of the build that is there."""
    if status.last_change and status.mode:
        loaded.update({region.name: design.number for region in status.regions if region.state == "ready"})


def do(
    deed: str,
    draw: random.Random,
    manager: Manager,
    sim: SimBoard,
    design: Design,
    board: cm.Board,
    loaded: dict[str, int],
) -> None:
    """One deed."""
    if deed == "build":
        design.build()
    elif deed in ("kill", "stop"):
        manager.kill() if deed == "kill" else manager.stop()
        manager.start()
    elif deed == "lose":
        sim.kill()
        sim.restart()
        loaded.clear()
        until(lambda: not board.status.config_name)
    elif deed == "unload":
        with suppress(CmError):  # nothing may be loaded
            board.unload(draw.choice(("", "prr0", "prr1")))
    else:
        try:
            board.load("camera", draw.choice(MODES), force=deed == "force")
        except CmError:
            return
        loaded.update({region.name: design.number for region in board.status.regions if region.state == "ready"})

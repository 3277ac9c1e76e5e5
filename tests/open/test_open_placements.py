# SPDX-License-Identifier: Apache-2.0
"""Random designs by the open flow: regions anywhere, modules of everything; what the bits do, and where they are.

CM_PLACEMENTS=N (make soak) builds N of them from CM_SEED on, for the device CM_DEVICE: a minute or two each.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from placements import Placement, draw
from twins import Built, compare
from xray_oracle import frames_read, read_bits

from cm.design.generate.generation import load_design
from cm.design.openflow.layout import layouts
from cm.design.openflow.tools import Tools, fetched
from cm.formats.xray import Database, decode, from_bytes, set_bits
from cm.formats.xray.frames import ECC_MASK

pytestmark = pytest.mark.timeout(1800)
COUNT = int(os.environ.get("CM_PLACEMENTS", "0"))
FIRST = int(os.environ.get("CM_SEED", "1"))
SEEDS = range(FIRST, FIRST + COUNT)
DEVICE = os.environ.get("CM_DEVICE", "xc7z010")
CYCLES = int(os.environ.get("CM_CYCLES", "100000"))
Bits = set[tuple[int, int, int]]


def built(placement: Placement, folder: Path) -> Path:
    """The project after the commands of docs/open-flow.md."""
    placement.write(folder)
    for words in (
        ["check", "--flow", "open"],
        ["generate"],
        ["run", "--flow", "open", "-j", "1"],
        ["collect", "--schema", "build.yaml"],
    ):
        command = [sys.executable, "-m", "cm", "build", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        (folder / f"{words[0]}.log").write_text(done.stdout + done.stderr)
        assert done.returncode == 0, f"{placement}\n{done.stdout}{done.stderr}"
    return folder


def check_bits(placement: Placement, project: Path, folder: Path) -> None:
    """bitread finds our bits in the full bitstream; in a partial one, those of its region's columns and no others."""
    tree = fetched()
    assert tree is not None
    system = load_design(project / "build.yaml").system
    database = Database.open(system.project.part)
    places = layouts(system, database)
    image = project / f"build/bitstreams/{system.full}.bit"
    whole = {far: from_bytes(data) for far, data in frames_read(image, placement.device).items()}
    full = {(far, *divmod(at, 32)) for far, frame in whole.items() for at in set_bits(frame & ~ECC_MASK)}
    assert read_bits(tree, placement.device, image.read_bytes(), folder) == full
    first = set(system.runs[0].values())
    for one in system.implementations:
        columns = places[one.region.name].columns
        image = project / f"build/bitstreams/{one.name}.bit"
        found = read_bits(tree, placement.device, image.read_bytes(), folder)
        assert {far >> 7 for far, _, _ in found} <= columns
        if one.name in first:
            assert found == {bit for bit in full if bit[0] >> 7 in columns}
        frames: dict[int, int] = {}
        for far, word, bit in found:
            frames[far] = frames.get(far, 0) | 1 << 32 * word + bit
        assert not decode(database, frames).unexplained


def beside(made: Built, name: str) -> list[str]:
    """A module of another region, where there is one."""
    return [one for one, region in made.regions.items() if region != made.regions[name]][:1]


@pytest.mark.skipif(not COUNT, reason="CM_PLACEMENTS=N (make soak) builds N random designs: a minute or two each")
@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_design_does_by_its_bits_what_its_verilog_does(seed: int, tools: Tools, tmp_path: Path) -> None:
    placement = draw(seed, DEVICE)
    project = built(placement, tmp_path / "project")
    check_bits(placement, project, tmp_path)
    made = Built(project, tmp_path)
    twins = [made.twin(name, *beside(made, name)) for name in made.regions]
    notes = {twin.name: twin.netlist.notes for twin in twins if twin.netlist.notes}
    assert not notes, placement
    results = compare(tmp_path, twins, CYCLES)
    assert {name: one.wrong for name, one in results.items()} == dict.fromkeys(results, 0), placement
    assert all(one.changes > CYCLES // 20 for one in results.values()), results

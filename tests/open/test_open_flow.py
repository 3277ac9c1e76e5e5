# SPDX-License-Identifier: Apache-2.0
"""The open flow on the example: its bitstreams, read by programs that nobody here wrote, and taken by a manager."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from manager_process import served
from xray_oracle import frames_read, part, read_bits, run

import cm
from cm.design.debian_packages import PackageTree
from cm.design.generate.generation import load_design
from cm.design.openflow.layout import layouts
from cm.design.openflow.tools import Tools, fetched
from cm.formats.bitstream import footprint_of, inspect
from cm.formats.xray import Database, decode, encode, from_bytes, read_features, set_bits, with_ecc
from cm.formats.xray.frames import ECC_MASK

pytestmark = pytest.mark.timeout(1500)  # the first of them runs the flow
MODULES = ("default", "edge", "colorise")
NAME = "open_camera"


@pytest.fixture(scope="session")
def tree(tools: Tools) -> PackageTree:
    found = fetched()
    assert found is not None
    return found


@pytest.fixture(scope="session")
def full(open_project: Path) -> dict[int, int]:
    """The frames of the full bitstream."""
    read = frames_read(open_project / f"build/bitstreams/{NAME}_full.bit", "xc7z010")
    return {far: from_bytes(data) for far, data in read.items()}


def bits(frames: dict[int, int]) -> set[tuple[int, int, int]]:
    return {(far, *divmod(at, 32)) for far, frame in frames.items() for at in set_bits(frame & ~ECC_MASK)}


def image(project: Path, name: str) -> Path:
    return project / f"build/bitstreams/{name}.bit"


def test_bitread_finds_exactly_the_bits_of_the_full_bitstream(
    open_project: Path, full: dict[int, int], tree: PackageTree, tmp_path: Path
) -> None:
    found = read_bits(tree, "xc7z010", image(open_project, f"{NAME}_full").read_bytes(), tmp_path)
    assert found == bits(full)
    assert len(found) > 40_000


def test_xc7frames2bit_gives_the_same_full_bitstream_frame_by_frame(
    full: dict[int, int], tree: PackageTree, tmp_path: Path
) -> None:
    """Checksums included: they are its own."""
    lines = (
        f"0x{far:08x} " + ",".join(f"0x{frame >> 32 * word & 0xFFFFFFFF:08x}" for word in range(101))
        for far, frame in sorted(full.items())
        if frame
    )
    (tmp_path / "in.frm").write_text("\n".join(lines) + "\n")
    files = ["--frm_file", str(tmp_path / "in.frm"), "--output_file", str(tmp_path / "out.bit")]
    run(tree, "xc7frames2bit", "--part_name", "xc7z010clg400-1", "--part_file", str(part(tree, "xc7z010")), *files)
    theirs = frames_read(tmp_path / "out.bit", "xc7z010")
    assert {far: from_bytes(data) for far, data in theirs.items()} == full
    assert all(frame == with_ecc(frame) for frame in full.values())


@pytest.mark.parametrize("name", MODULES)
def test_bitread_finds_in_a_partial_the_features_of_static_part_and_module_and_only_in_the_regions_columns(
    open_project: Path, full: dict[int, int], tools: Tools, tree: PackageTree, tmp_path: Path, name: str
) -> None:
    design = load_design(open_project / "build.yaml")
    database = Database.open("xc7z010clg400-1", tools.database)
    (layout,) = layouts(design.system, database).values()
    found = read_bits(tree, "xc7z010", image(open_project, name).read_bytes(), tmp_path)
    assert {far >> 7 for far, _, _ in found} <= layout.columns
    frames: dict[int, int] = {}
    for far, word, bit in found:
        frames[far] = frames.get(far, 0) | 1 << 32 * word + bit
    decoded = decode(database, frames)
    assert not decoded.unexplained  # every bit that bitread sees has a meaning
    written = read_features((open_project / f"build/open/{name}.fasm").read_text().splitlines())
    logic = {f for f in written if f.tile in {tile.name for tile in layout.logic_tiles} and f.tile.startswith("CLB")}
    known = {f for f in logic if encode(database, {f}).frames}
    assert known <= decoded.features  # all that nextpnr wrote of the module's logic, and
    mine = {f for f in decoded.features if f.tile in {t.name for t in layout.logic_tiles} and ".INIT[" in f.name}
    assert {f for f in mine if f.tile.startswith("CLB")} <= written  # no table's bit that it did not write
    if name == "default":
        assert found == {bit for bit in bits(full) if bit[0] >> 7 in layout.columns}


def test_modules_differ_and_static_frames_do_not(open_project: Path, full: dict[int, int]) -> None:
    reports = {name: inspect(image(open_project, name)) for name in MODULES}
    assert len({report.sha256 for report in reports.values()}) == 3
    assert {report.user_id for report in reports.values()} == {inspect(image(open_project, f"{NAME}_full")).user_id}
    assert {footprint_of(report) for report in reports.values()} == {footprint_of(reports["edge"])}
    assert all(report.problems == () for report in reports.values())


def test_a_manager_loads_each_module(open_project: Path) -> None:
    with served(schemas=open_project / f"target/{NAME}") as (manager, _), manager.connected() as board:
        for mode, module in (("edge_detection", "edge"), ("colorise", "colorise"), ("default", "default")):
            board.load(NAME, mode)
            assert [region.module for region in board.status.regions] == [module]


def another_region(data: dict[str, Any]) -> None:
    region = data["regions"]["prr0"]
    region["footprint"] = [dict(entry, columns=[1, 2]) for entry in region["footprint"]]


def another_device(data: dict[str, Any]) -> None:
    data["device"] = "xc7z020clg400-1"


def another_static_part(data: dict[str, Any]) -> None:
    data["static"]["user_id"] ^= 1


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (another_region, "footprint_outside"),
        (another_device, "wrong_device"),
        (another_static_part, "wrong_static"),
    ],
)
def test_a_manager_refuses_a_module_made_for_something_else(
    open_project: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None], code: str
) -> None:
    folder = tmp_path / NAME
    shutil.copytree(open_project / f"target/{NAME}", folder)
    for name in MODULES:  # with their headers, which the .bin files do not have
        (folder / f"{name}.bin").unlink()
        shutil.copy(image(open_project, name), folder)
    data = yaml.safe_load((folder / f"{NAME}.yaml").read_text())
    for module in data["config"]["modules"].values():
        module.pop("sha256")
        module.pop("bitstream", None)
    change(data["config"])
    (folder / f"{NAME}.yaml").write_text(yaml.safe_dump(data))
    with served(schemas=folder) as (manager, _), manager.connected() as board:
        with pytest.raises(cm.CmError) as refused:
            board.load(NAME, "edge_detection")
        assert refused.value.code == code


def test_the_same_seed_gives_the_same_bits_and_another_module_is_not_built_again(
    open_project: Path, tools: Tools, tmp_path: Path
) -> None:
    """A changed module costs its own steps; the static part and the others are taken from before."""
    shutil.copytree(open_project.parent / "camera", tmp_path / "camera")
    shutil.copytree(open_project, tmp_path / NAME)
    project = tmp_path / NAME
    before = {name: image(project, name).read_bytes() for name in MODULES}
    (project / "build/open/place_default.key").unlink()  # as if it had been killed there
    source = tmp_path / "camera/hdl/camera_colorise.v"
    source.write_text(source.read_text().replace("8'd", "8'd", 1) + "\n")
    command = [sys.executable, "-m", "cm", "build", "run", "--flow", "open"]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "place_default: done" in done.stdout
    assert "synth_colorise: done" in done.stdout
    for step in ("synth_static", "synth_edge", "synth_default", "place_static", "place_edge"):
        assert step not in done.stdout  # though the folder is another
    assert {name: image(project, name).read_bytes() for name in MODULES} == before


@pytest.mark.skipif(shutil.which("verilator") is None, reason="needs verilator, which is not installed")
def test_the_demonstration_ends_with_pictures_through_modules_that_run_from_their_bits(
    open_project: Path, tmp_path: Path
) -> None:
    example = Path(__file__).resolve().parents[2] / "examples" / "open_camera.py"
    command = [sys.executable, str(example), str(open_project / "build.yaml"), str(tmp_path / "sheet.png")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    for name, size in (("DEFA", "480×640"), ("EDGE", "480×640"), ("COLO", "480×640×3")):
        assert f"its bits say {name!r}, a picture of {size} came back, 1 counted" in done.stdout
    assert (tmp_path / "sheet.png").stat().st_size > 10_000

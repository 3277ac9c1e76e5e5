# SPDX-License-Identifier: Apache-2.0
"""Generated overlays compile without a warning, apply to a board's tree, and say what the runtime schema says."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs

from cm import schema
from cm.design.collect.collected import QUIET
from cm.design.plan.system import System

DTS = Path(__file__).parents[3] / "dts"
BOARDS = {"camera": "zynq-7000", "two_regions": "kv260"}

pytestmark = [needs("dtc"), needs("fdtoverlay"), needs("cpp")]


@pytest.fixture(scope="module", params=sorted(BOARDS))
def built(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[System, Path]:
    design, out = generated(copy_examples(tmp_path_factory.mktemp("dts")), request.param)
    return design.system, out


def compile_tree(source: Path, target: Path, *flags: str) -> None:
    command = ["dtc", "-@", *flags, "-I", "dts", "-O", "dtb", "-o", str(target), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr, done.stderr


def board_source(system: System, folder: Path) -> Path:
    """The board's tree, through the preprocessor."""
    target = folder / "board.dts"
    command = ["cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-I", str(DTS / "boards"), "-P"]
    source = DTS / "boards" / f"{BOARDS[system.project.name]}.dts"
    subprocess.run([*command, str(source), str(target)], check=True)
    return target


def apply(base: Path, *overlays: Path) -> Path:
    """The merged tree."""
    merged = base.with_suffix(".merged")
    subprocess.run(["fdtoverlay", "-i", base, "-o", merged, *overlays], check=True, capture_output=True)
    return merged


def fdtget(tree: Path, *words: str) -> list[str]:
    """What fdtget prints: ``-l node`` lists children, ``node property`` a property's values."""
    flags = [word for word in words if word.startswith("-")]
    rest = [word for word in words if not word.startswith("-")]
    done = subprocess.run(["fdtget", *flags, str(tree), *rest], check=True, capture_output=True, text=True)
    return done.stdout.split()


def compiled(system: System, out: Path, folder: Path) -> tuple[Path, dict[str, Path]]:
    base = folder / "base.dtb"
    compile_tree(board_source(system, folder), base, "-Wno-unit_address_vs_reg")
    overlays = {}
    for source in sorted((out / "dts").glob("*.dtso")):
        overlays[source.stem] = folder / f"{source.stem}.dtbo"
        compile_tree(source, overlays[source.stem], *QUIET)
    return base, overlays


def test_every_overlay_compiles_and_applies_over_the_static_one(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    static = overlays[f"{system.project.name}_static"]
    for name, overlay in overlays.items():
        tree = apply(base, static) if overlay == static else apply(base, static, overlay)
        assert "cm-streams" in fdtget(tree, "-l", "/"), name


def test_overlays_put_nothing_below_a_bus_that_they_add(built: tuple[System, Path], tmp_path: Path) -> None:
    """The kernel would make no devices of it: of_platform_notify looks at the parent of each new node only."""
    system, out = built
    _, overlays = compiled(system, out, tmp_path)
    for overlay in overlays.values():
        text = subprocess.run(["dtc", "-q", "-I", "dtb", "-O", "dts", overlay], check=True, capture_output=True).stdout
        assert b"simple-bus" not in text
        assert b"simple-mfd" not in text


def test_every_interrupt_says_whose_it_is(built: tuple[System, Path], tmp_path: Path) -> None:
    """The root of a Zynq's tree has no interrupt-parent."""
    system, out = built
    _, overlays = compiled(system, out, tmp_path)
    for overlay in overlays.values():
        done = subprocess.run(["dtc", "-q", "-I", "dtb", "-O", "dts", overlay], check=True, capture_output=True)
        lines = [line.strip() for line in done.stdout.decode().splitlines()]
        nodes = [index for index, line in enumerate(lines) if line.startswith("interrupts = ")]
        assert all(lines[index - 1].startswith("interrupt-parent = ") for index in nodes)


def test_the_pl_clocks_are_set_to_the_rates_of_the_build_schema(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    tree = apply(base, overlays[f"{system.project.name}_static"])
    names = fdtget(tree, "/cm-clocks", "clock-names")
    assert names == list(system.project.clocks)
    rates = [str(system.project.clocks[name].rate) for name in names]
    assert fdtget(tree, "/cm-clocks", "assigned-clock-rates") == rates


def test_the_overlays_of_a_modes_modules_have_their_windows(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    for mode in system.project.modes.values():
        mine = [overlays[f"module_{system.implementation(*pair).name}"] for pair in map(reversed, mode.modules.items())]
        tree = apply(base, overlays[f"{system.project.name}_static"], *mine)
        for region in mode.modules:
            windows = [f"{bus.window.base:x}" for bus in system.region(region).registers]
            place = f"/fpga-region-{system.region(region).index}"
            nodes = fdtget(tree, "-l", place)
            assert [node.partition("@")[2] for node in nodes] == windows
            for node in nodes:
                assert fdtget(tree, f"{place}/{node}", "compatible") == ["fpga-cm,window", "fpga-cm,uio", "generic-uio"]


def test_the_static_overlay_has_a_channel_for_every_stream_of_the_schema(
    built: tuple[System, Path], tmp_path: Path
) -> None:
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    tree = apply(base, overlays[f"{system.project.name}_static"])
    config = schema.load(out / f"config/{system.project.name}.yaml")
    assert fdtget(tree, "/cm-streams", "dma-names") == [stream.channel for stream in config.streams.values()]
    directions = {"1": "mm2s", "2": "s2mm"}
    have = [directions[word] for word in fdtget(tree, "/cm-streams", "fpga-cm,directions")]
    assert have == [stream.direction.value for stream in config.streams.values()]


def test_decouplers_have_the_addresses_in_the_runtime_schema(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    tree = apply(base, overlays[f"{system.project.name}_static"])
    config = schema.load(out / f"config/{system.project.name}.yaml")
    for region in config.regions.values():
        assert region.decoupler is not None
        address = region.decoupler.base_address + region.decoupler.offset
        assert f"fpga-bridge@{address:x}" in fdtget(tree, "-l", "/")


def test_the_same_nodes_go_into_a_boards_own_tree(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    whole = tmp_path / "whole.dts"
    shutil.copy(out / "dts/system-user.dtsi", tmp_path)
    whole.write_text(board_source(system, tmp_path).read_text() + '\n/include/ "system-user.dtsi"\n')
    compile_tree(whole, tmp_path / "whole.dtb", "-Wno-unit_address_vs_reg")


def test_the_merged_trees_are_what_the_bindings_allow(built: tuple[System, Path], tmp_path: Path) -> None:
    tool = Path(sysconfig.get_path("scripts")) / "dt-validate"
    if not tool.exists():
        pytest.skip("needs the PyPI package dtschema")
    system, out = built
    base, overlays = compiled(system, out, tmp_path)
    static = overlays.pop(f"{system.project.name}_static")
    trees = []
    for name, overlay in overlays.items():
        trees.append(tmp_path / f"{name}.merged.dtb")
        subprocess.run(["fdtoverlay", "-i", base, "-o", trees[-1], static, overlay], check=True, capture_output=True)
    command = [sys.executable, str(tool), "-s", str(DTS / "bindings"), *map(str, trees)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = (done.stdout + done.stderr).splitlines()
    assert not [line for line in lines if any(str(tree) in line for tree in trees)]
    assert done.returncode == 0, lines


def test_a_region_of_loader_overlay_names_its_firmware(tmp_path: Path) -> None:
    folder = copy_examples(tmp_path)
    path = folder / "camera/build.yaml"
    path.write_text(path.read_text().replace("loader: auto", "loader: overlay"))
    _, out = generated(folder, "camera")
    text = (out / "dts/module_edge.dtso").read_text()
    assert 'firmware-name = "cm/camera/edge.bin";' in text
    assert "partial-fpga-config;" in text

# SPDX-License-Identifier: Apache-2.0
"""Generated overlays compile without a warning, apply to a board's tree, and say what the runtime schema says."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest
from build_support import MINIMAL, copy_examples, generated, needs, project

from cm import schema
from cm.design.collect.collected import QUIET
from cm.design.generate.generation import generate, load_design
from cm.design.plan.system import System
from cm.schema.model import Config

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


@dataclass(frozen=True)
class Trees:
    """A design with its overlays compiled, the board's own tree, and that with the static part's overlay applied."""

    system: System
    out: Path
    config: Config
    base: Path
    overlays: dict[str, Path]
    static: Path
    whole: Path


@pytest.fixture(scope="module")
def trees(built: tuple[System, Path], tmp_path_factory: pytest.TempPathFactory) -> Trees:
    system, out = built
    folder, name = tmp_path_factory.mktemp("trees"), system.project.name
    base = folder / "base.dtb"
    compile_tree(board_source(system, folder), base, "-Wno-unit_address_vs_reg")
    overlays = {}
    for source in sorted((out / "dts").glob("*.dtso")):
        overlays[source.stem] = folder / f"{source.stem}.dtbo"
        compile_tree(source, overlays[source.stem], *QUIET)
    static = overlays.pop(f"{name}_static")
    config = schema.load(out / f"config/{name}.yaml")
    return Trees(system, out, config, base, overlays, static, apply(base, static))


def test_every_overlay_compiles_and_applies_over_the_static_one(trees: Trees, tmp_path: Path) -> None:
    base = shutil.copy(trees.base, tmp_path)
    for name, overlay in trees.overlays.items():
        assert "cm-streams" in fdtget(apply(Path(base), trees.static, overlay), "-l", "/"), name


def test_overlays_put_nothing_below_a_bus_that_they_add_and_every_interrupt_says_whose_it_is(trees: Trees) -> None:
    """The kernel would make no devices of it: of_platform_notify looks at the parent of each new node only.

    The root of a Zynq's tree has no interrupt-parent.
    """
    for overlay in (trees.static, *trees.overlays.values()):
        done = subprocess.run(["dtc", "-q", "-I", "dtb", "-O", "dts", overlay], check=True, capture_output=True)
        text = done.stdout.decode()
        assert "simple-bus" not in text
        assert "simple-mfd" not in text
        lines = [line.strip() for line in text.splitlines()]
        nodes = [index for index, line in enumerate(lines) if line.startswith("interrupts = ")]
        assert all(lines[index - 1].startswith("interrupt-parent = ") for index in nodes)


def test_the_pl_clocks_are_set_to_the_rates_of_the_build_schema(trees: Trees) -> None:
    clocks = trees.system.project.clocks
    names = fdtget(trees.whole, "/cm-clocks", "clock-names")
    assert names == list(clocks)
    rates = [str(clocks[name].rate) for name in names]
    assert fdtget(trees.whole, "/cm-clocks", "assigned-clock-rates") == rates


def test_the_overlays_of_a_modes_modules_have_their_windows(trees: Trees, tmp_path: Path) -> None:
    system, base = trees.system, Path(shutil.copy(trees.base, tmp_path))
    for mode in system.project.modes.values():
        pairs = map(reversed, mode.modules.items())
        mine = [trees.overlays[f"module_{system.implementation(*pair).name}"] for pair in pairs]
        tree = apply(base, trees.static, *mine)
        for region in mode.modules:
            windows = [f"{bus.window.base:x}" for bus in system.region(region).registers]
            place = f"/fpga-region-{system.region(region).index}"
            nodes = fdtget(tree, "-l", place)
            assert [node.partition("@")[2] for node in nodes] == windows
            for node in nodes:
                assert fdtget(tree, f"{place}/{node}", "compatible") == ["fpga-cm,window", "fpga-cm,uio", "generic-uio"]


def test_the_static_overlay_has_the_streams_and_the_decouplers_of_the_runtime_schema(trees: Trees) -> None:
    streams = trees.config.streams.values()
    assert fdtget(trees.whole, "/cm-streams", "dma-names") == [stream.channel for stream in streams]
    directions = {"1": "mm2s", "2": "s2mm"}
    have = [directions[word] for word in fdtget(trees.whole, "/cm-streams", "fpga-cm,directions")]
    assert have == [stream.direction.value for stream in streams]
    for region in trees.config.regions.values():
        assert region.decoupler is not None
        address = region.decoupler.base_address + region.decoupler.offset
        assert f"fpga-bridge@{address:x}" in fdtget(trees.whole, "-l", "/")


def test_the_same_nodes_go_into_a_boards_own_tree(built: tuple[System, Path], tmp_path: Path) -> None:
    system, out = built
    whole = tmp_path / "whole.dts"
    shutil.copy(out / "dts/system-user.dtsi", tmp_path)
    whole.write_text(board_source(system, tmp_path).read_text() + '\n/include/ "system-user.dtsi"\n')
    compile_tree(whole, tmp_path / "whole.dtb", "-Wno-unit_address_vs_reg")


def test_the_merged_trees_are_what_the_bindings_allow(trees: Trees, tmp_path: Path) -> None:
    tool = Path(sysconfig.get_path("scripts")) / "dt-validate"
    if not tool.exists():
        pytest.skip("needs the PyPI package dtschema")
    merged = []
    for name, overlay in trees.overlays.items():
        merged.append(tmp_path / f"{name}.merged.dtb")
        command = ["fdtoverlay", "-i", trees.base, "-o", merged[-1], trees.static, overlay]
        subprocess.run(command, check=True, capture_output=True)
    words = [sys.executable, str(tool), "-s", str(DTS / "bindings"), *map(str, merged)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    lines = (done.stdout + done.stderr).splitlines()
    assert not [line for line in lines if any(str(tree) in line for tree in merged)]
    assert done.returncode == 0, lines


def test_a_region_of_loader_overlay_names_its_firmware(tmp_path: Path) -> None:
    folder = copy_examples(tmp_path)
    path = folder / "camera/build.yaml"
    path.write_text(path.read_text().replace("loader: auto", "loader: overlay"))
    _, out = generated(folder, "camera")
    text = (out / "dts/edge.dtso").read_text()  # by this name the manager looks for what loads a module
    assert 'firmware-name = "cm/camera/edge.bin";' in text
    assert "partial-fpga-config;" in text
    assert "edge-s-axi@" in text
    modes = schema.load(out / "config/camera.yaml").modes.values()
    assert [mode.overlays for mode in modes] == [(), (), ()]  # the kernel would take no other on the region


def test_registers_of_the_static_designs_own_part_have_devices(tmp_path: Path) -> None:
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    registers = "{leds: {offset: 0x41200000}, tri: {offset: 0x41201ffc}, id: {offset: 0x41300010}}"
    design = load_design(project(tmp_path, MINIMAL + f"static: {{registers: {registers}}}\n"))
    generate(design, tmp_path / "build")
    for name in ("small_static.dtso", "system-user.dtsi"):
        text = (tmp_path / "build/dts" / name).read_text()
        found = re.findall(r"cm-registers@(\w+) \{\n.*\n\t\treg = <(\w+) (\w+)>;", text)
        assert found == [("41200000", "0x41200000", "0x2000"), ("41300000", "0x41300000", "0x1000")]

# SPDX-License-Identifier: Apache-2.0
"""Device trees: every overlay compiles, applies to its board's tree, and is what the bindings allow."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import pytest

DTS = Path(__file__).parents[3] / "dts"
BOARDS = sorted(path.stem for path in (DTS / "boards").glob("*.dts"))
OVERLAYS = sorted(str(path.relative_to(DTS / "overlays").with_suffix("")) for path in DTS.glob("overlays/*/*.dtso"))
BINDINGS = sorted((DTS / "bindings").rglob("*.yaml"))
ALONE = {"static", "leds", "axidma", "pool", "silicon-polled"}  # overlays that apply to the board's tree itself
SCRIPTS = Path(sysconfig.get_path("scripts"))

pytestmark = pytest.mark.skipif(
    not all(shutil.which(tool) for tool in ("dtc", "fdtoverlay", "cpp", "make")),
    reason="needs dtc, fdtoverlay, cpp and make (Debian: device-tree-compiler, cpp, make)",
)


def schema_tool(name: str) -> str:
    """A program of the PyPI package dtschema, or a skip."""
    found = SCRIPTS / name
    if not found.exists():
        pytest.skip("needs the PyPI package dtschema")
    return str(found)


def run(*command: str | Path) -> str:
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def apply(base: Path, *overlays: Path) -> Path:
    target = base.parent / ("-".join([base.stem, *(path.stem for path in overlays)]) + ".merged.dtb")
    run("fdtoverlay", "-i", base, "-o", target, *overlays)
    return target


def properties(tree: Path, node: str) -> set[str]:
    return set(run("fdtget", "-p", tree, node).split())


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with everything that `make dtbo` makes."""
    folder = tmp_path_factory.mktemp("dts")
    assert run("make", "-s", "-C", DTS, f"O={folder}", "dtbo") == ""  # no warning either
    return folder


def merged(built: Path, overlay: str) -> Path:
    board, name = overlay.split("/")
    needs = [] if name in ALONE else [built / board / "static.dtbo"]
    return apply(built / f"{board}.dtb", *needs, built / f"{overlay}.dtbo")


@pytest.fixture(scope="module")
def verdicts(built: Path) -> Iterator[dict[str, str]]:
    """dt-validate's messages about each board's tree with each overlay."""
    tool = schema_tool("dt-validate")
    trees = {overlay: merged(built, overlay) for overlay in OVERLAYS}
    done = subprocess.run(
        [sys.executable, tool, "-s", str(DTS / "bindings"), *map(str, trees.values())],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = (done.stdout + done.stderr).splitlines()
    yield {overlay: "\n".join(line for line in lines if str(tree) in line) for overlay, tree in trees.items()}
    assert not [line for line in lines if line.startswith("Traceback")]


def test_there_are_boards_and_overlays() -> None:
    assert {"qemu-virt", "zynq-7000", "ultra96", "zcu104", "kv260"} == set(BOARDS)
    assert {f"{board}/static" for board in BOARDS} <= set(OVERLAYS)


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_overlay_applies_to_its_board(built: Path, overlay: str) -> None:
    assert merged(built, overlay).stat().st_size > (built / f"{overlay.split('/')[0]}.dtb").stat().st_size


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_overlay_is_what_the_bindings_allow(verdicts: dict[str, str], overlay: str) -> None:
    assert verdicts[overlay] == ""


@pytest.mark.parametrize("overlay", OVERLAYS)
def test_plain_overlay_has_no_symbols(built: Path, overlay: str) -> None:
    decompiled = run("dtc", "-q", "-I", "dtb", "-O", "dts", built / "plain" / f"{overlay}.dtbo")
    assert "__symbols__" not in decompiled


@pytest.mark.parametrize("board", BOARDS)
def test_static_overlay_exports_its_regions(built: Path, board: str) -> None:
    symbols = properties(built / board / "static.dtbo", "/__symbols__")
    assert {"prr0", "prr1", "icap", "decoupler0", "decoupler1"} <= symbols


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("module", ["default", "edge", "colorise"])
def test_module_names_its_own_bitstream(built: Path, board: str, module: str) -> None:
    text = run("dtc", "-q", "-I", "dtb", "-O", "dts", built / board / f"{module}.dtbo")
    assert f'firmware-name = "cm/camera/{module}.bit.bin"' in text
    assert "partial-fpga-config;" in text


@pytest.mark.parametrize("board", BOARDS)
def test_camera_overlay_names_no_bitstream(built: Path, board: str) -> None:
    text = run("dtc", "-q", "-I", "dtb", "-O", "dts", built / board / "camera.dtbo")
    assert "firmware-name" not in text


def test_overlay_by_path_applies_to_a_tree_without_symbols(built: Path) -> None:
    source = run("dtc", "-q", "-I", "dtb", "-O", "dts", built / "qemu-virt.dtb")
    start = source.index("__symbols__")
    bare = built / "bare.dts"
    bare.write_text(source[:start].rstrip() + "\n};\n")
    run("dtc", "-q", "-I", "dts", "-O", "dtb", "-o", built / "bare.dtb", bare)
    tree = apply(built / "bare.dtb", built / "plain/qemu-virt/leds.dtbo")
    assert "compatible" in properties(tree, "/pl-bus/leds@58004000")


@pytest.mark.parametrize("binding", BINDINGS, ids=lambda path: path.stem)
def test_binding_lies_where_its_id_says(binding: Path) -> None:
    first = next(line for line in binding.read_text().splitlines() if line.startswith("$id: "))
    place = binding.relative_to(DTS / "bindings")
    assert first == f"$id: http://devicetree.org/schemas/{place}#"


def test_bindings_are_good_schemas() -> None:
    tool = schema_tool("dt-doc-validate")
    assert run(sys.executable, tool, "-u", DTS / "bindings", *BINDINGS) == ""


def test_examples_of_bindings_are_what_they_allow(tmp_path: Path) -> None:
    """The other half of the kernel's `make dt_binding_check`."""
    extract, validate = schema_tool("dt-extract-example"), schema_tool("dt-validate")
    trees = []
    for binding in BINDINGS:
        source = tmp_path / f"{binding.stem}.dts"
        source.write_text(run(sys.executable, extract, binding))
        trees.append(source.with_suffix(".dtb"))
        run("dtc", "-q", "-I", "dts", "-O", "dtb", "-o", trees[-1], source)
    assert run(sys.executable, validate, "-s", DTS / "bindings", *trees) == ""


def test_wrong_properties_are_reported(built: Path, tmp_path: Path) -> None:
    tool = schema_tool("dt-validate")
    text = run("dtc", "-q", "-I", "dtb", "-O", "dts", merged(built, "qemu-virt/static"))
    changes = {
        "<0x02 0x01 0x02>": "<0x02 0x01 0x03>",  # a direction that does not exist
        'dma-names = "icap': 'dma-names = "port',
        "fpga-cm,kind = ": "fpga-cm,sort = ",
    }
    for was, becomes in changes.items():
        assert was in text
        text = text.replace(was, becomes)
    (tmp_path / "broken.dts").write_text(text)
    run("dtc", "-q", "-I", "dts", "-O", "dtb", "-o", tmp_path / "broken.dtb", tmp_path / "broken.dts")
    done = subprocess.run(
        [sys.executable, tool, "-s", str(DTS / "bindings"), str(tmp_path / "broken.dtb")],
        capture_output=True,
        text=True,
        check=False,
    )
    told = done.stdout + done.stderr
    for schema in ("fpga-cm,dma-client", "fpga-cm,icap-loader", "fpga-cm,plsim-dma"):
        assert f"schemas/{schema}.yaml" in told

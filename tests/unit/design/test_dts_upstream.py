# SPDX-License-Identifier: Apache-2.0
"""Every overlay on the kernel's own trees of its boards, against the kernel's own bindings.

`LINUX_SOURCE` names a kernel source with Documentation/devicetree/bindings, arch/*/boot/dts/xilinx and
include/dt-bindings; Debian's linux-source-6.12 is what the overlays were checked with. It takes a minute, and 150 MB
to fetch, so it is asked for: `make -C dts check LINUX_SOURCE=DIR`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from build_support import copy_examples, generated, needs

DTS = Path(__file__).parents[3] / "dts"
BOARDS = {
    "zynq-7000": "arch/arm/boot/dts/xilinx/zynq-zc702.dts",
    "kv260": "arch/arm64/boot/dts/xilinx/zynqmp-sm-k26-revA.dts",
    "zcu104": "arch/arm64/boot/dts/xilinx/zynqmp-zcu104-revC.dts",
    "ultra96": "arch/arm64/boot/dts/xilinx/zynqmp-zcu100-revC.dts",
}
GENERATED = {"camera": "zynq-7000", "two_regions": "kv260"}
LACKING = ("xlnx,axi-dma", "xlnx,afi-fpga")  # upstream describes the first in prose only, the second not at all
EXPECTED = "vendor-prefixes.yaml"  # fpga-cm is not one of the kernel's
LINUX = Path(os.environ.get("LINUX_SOURCE", ""))

pytestmark = [
    pytest.mark.elsewhere,
    pytest.mark.skipif(not os.environ.get("LINUX_SOURCE"), reason="needs a kernel source, named by LINUX_SOURCE"),
    *(needs(tool) for tool in ("dtc", "fdtoverlay", "cpp", "make")),
]


def run(*command: str | Path) -> str:
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def schemas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kernel's bindings and ours, processed."""
    tool = Path(sysconfig.get_path("scripts")) / "dt-mk-schema"
    if not tool.exists():
        pytest.skip("needs the PyPI package dtschema")
    folder = tmp_path_factory.mktemp("schemas")
    shutil.copytree(LINUX / "Documentation/devicetree/bindings", folder / "bindings")
    for binding in (DTS / "bindings").glob("*.yaml"):
        shutil.copy(binding, folder / "bindings")
    (folder / "bindings/kernel").mkdir()
    for name in LACKING:
        shutil.copy(DTS / f"bindings/kernel/{name}.yaml", folder / "bindings/kernel")
    run(sys.executable, tool, "-j", "-o", folder / "processed.json", folder / "bindings")
    return folder / "processed.json"


@pytest.fixture(scope="module")
def trees(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The kernel's own tree of each board, with symbols."""
    folder, found = tmp_path_factory.mktemp("trees"), {}
    for board, source in BOARDS.items():
        text, found[board] = folder / f"{board}.dts", folder / f"{board}.dtb"
        where = ("-I", (LINUX / source).parent, "-I", LINUX / "include", "-I", LINUX / "arch/arm/boot/dts")
        run("cpp", "-nostdinc", "-undef", "-D__DTS__", "-x", "assembler-with-cpp", "-P", *where, LINUX / source, text)
        run("dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", found[board], text)
    return found


def complaints(schemas: Path, tree: Path) -> set[str]:
    """The complaints of dt-validate about a tree, except those about a vendor that the kernel does not know."""
    tool = Path(sysconfig.get_path("scripts")) / "dt-validate"
    done = subprocess.run([sys.executable, tool, "-s", schemas, tree], capture_output=True, text=True, check=False)
    said = (done.stdout + done.stderr).replace(f"{tree}: ", "\0").split("\0")
    return {message for message in said if message.strip() and EXPECTED not in message}


def check(schemas: Path, base: Path, target: Path, *overlays: Path) -> None:
    run("fdtoverlay", "-i", base, "-o", target, *overlays)
    assert complaints(schemas, target) - complaints(schemas, base) == set()


@pytest.mark.parametrize("board", sorted(BOARDS))
def test_overlays_of_a_board_are_what_the_kernels_bindings_allow(
    board: str, schemas: Path, trees: dict[str, Path], tmp_path: Path
) -> None:
    run("make", "-s", "-C", DTS, f"O={tmp_path}", "dtbo")
    static = tmp_path / board / "static.dtbo"
    for module in ("camera", "default", "edge", "colorise"):
        check(schemas, trees[board], tmp_path / "merged.dtb", static, tmp_path / board / f"{module}.dtbo")


@pytest.mark.parametrize("example", sorted(GENERATED))
def test_generated_overlays_are_what_the_kernels_bindings_allow(
    example: str, schemas: Path, trees: dict[str, Path], tmp_path: Path
) -> None:
    design, out = generated(copy_examples(tmp_path), example)
    made = {}
    for source in sorted((out / "dts").glob("*.dtso")):
        made[source.stem] = tmp_path / f"{source.stem}.dtbo"
        run("dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", made[source.stem], source)
    static = made.pop(f"{design.system.project.name}_static")
    for overlay in made.values():
        check(schemas, trees[GENERATED[example]], tmp_path / "merged.dtb", static, overlay)


def test_a_name_that_the_kernels_bindings_do_not_allow_is_reported(
    schemas: Path, trees: dict[str, Path], tmp_path: Path
) -> None:
    bad = tmp_path / "bad.dtso"
    bad.write_text(
        '/dts-v1/;\n/plugin/;\n&{/} { fpga-region-prr0 { compatible = "fpga-region"; fpga-mgr = <&zynqmp_pcap>; }; };\n'
    )
    run("dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", tmp_path / "bad.dtbo", bad)
    run("fdtoverlay", "-i", trees["zcu104"], "-o", tmp_path / "merged.dtb", tmp_path / "bad.dtbo")
    new = complaints(schemas, tmp_path / "merged.dtb") - complaints(schemas, trees["zcu104"])
    assert any("fpga-region-prr0" in message for message in new)

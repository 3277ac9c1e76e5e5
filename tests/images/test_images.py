# SPDX-License-Identifier: Apache-2.0
"""The overlays of `cm build generate` (docs/boards/loop) on trees of stock images: every clash, and none invented."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from build_support import needs
from trees import IMAGES, SOURCE_PACKAGE, build, linux

from cm.design.collect.stock_image import check_image
from cm.design.generate.generation import load_design
from cm.design.project.source_position import Finding

pytestmark = [pytest.mark.elsewhere, *(needs(tool) for tool in ("dtc", "fdtoverlay", "cpp"))]
ROOT = Path(__file__).parents[2]
LOOP = ROOT / "docs/boards/loop/build.yaml"
ZYNQ, ZYNQMP = "xc7z020clg400-1", "xck26-sfvc784-2LV-c"
INTC, GIC = "/axi/interrupt-controller@f8f01000", "/axi/interrupt-controller@f9010000"
FABRIC = "asks for what /fabric@{0} (generic-uio) has"
KEPT = "asks for what /amba_pl/dma@{0} (xlnx,axi-dma-7.1) has"


@pytest.fixture(scope="module")
def source() -> Path:
    """Debian's kernel source, as far as trees need it; in build/, where it stays."""
    try:
        return linux(ROOT / "build/images")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"needs {SOURCE_PACKAGE}, which apt does not give: {error.stderr.strip()}")


@pytest.fixture(scope="module")
def clashes(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], list[Finding]]:
    """What the example meets, built for a board by name or for a bare part, on an image."""
    pytest.importorskip("pyslang", reason="needs pyslang: the extra [build] is not installed")
    folder = tmp_path_factory.mktemp("images")

    def find(image: str, target: str) -> list[Finding]:
        key = "part" if target in (ZYNQ, ZYNQMP) else "board"
        text = LOOP.read_text().replace("board: pynq-z2", f"{key}: {target}").replace("../../..", str(ROOT))
        (folder / "build.yaml").write_text(text)
        tree = build(IMAGES[image], source, folder / f"{image}.dtb")
        return list(check_image(load_design(folder / "build.yaml").system, tree))

    return find


@pytest.mark.parametrize(
    ("image", "target"),
    [
        ("zybo-z7", "zybo-z7-20"), ("zybo-z7", ZYNQ), ("zcu104", "zcu104"), ("kv260", "kv260"), ("kv260", ZYNQMP),
        ("kr260", "kr260"),
        # the generator leaves out the interrupt that the board's image has given away
        ("pynq-z2", "pynq-z2"), ("zcu104-pynq", "zcu104"), ("kv260-pynq", "kv260"), ("kr260-pynq", "kr260"),
    ],
)  # fmt: skip
def test_nothing_is_found_where_nothing_clashes(
    clashes: Callable[[str, str], list[Finding]], image: str, target: str
) -> None:
    assert clashes(image, target) == []


@pytest.mark.parametrize(
    ("image", "target", "said"),
    [
        ("pynq-z2", ZYNQ, f"interrupt 0 29 of {INTC}: /cm-control@40000000 {FABRIC.format('40000000')}"),
        *(
            (image, ZYNQMP, f"interrupt 0 89 of {GIC}: /cm-control@a0000000 {FABRIC.format('a0000000')}")
            for image in ("zcu104-pynq", "kv260-pynq", "kr260-pynq")
        ),
        ("zybo-z7-pl-kept", "zybo-z7-20",
            f"registers at 0x44000000: /dma-controller@44000000 {KEPT.format('44000000')}"),
        ("zcu104-pl-kept", "zcu104",
            f"registers at 0xa4000000: /dma-controller@a4000000 {KEPT.format('a4000000')}"),
        ("zcu104-debian", "zcu104",
            "loop_static.dtbo: the tree has no __symbols__, so no overlay that names a label is taken (-EINVAL)"),
    ],
)  # fmt: skip
def test_every_clash_is_found_and_no_other(
    clashes: Callable[[str, str], list[Finding]], image: str, target: str, said: str
) -> None:
    assert [one.message for one in clashes(image, target)] == [f"{image}.dtb: {said}"]

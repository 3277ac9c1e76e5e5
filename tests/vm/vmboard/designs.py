# SPDX-License-Identifier: Apache-2.0
"""Designs as a user has them: what `cm build generate` makes of a shipped example, its overlays compiled."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from vmboard import hardware
from vmboard.cache import Cache, source_files
from vmboard.paths import REPOSITORY
from vmboard.shell import require, run

EXAMPLE = REPOSITORY / "cm/data/examples/camera"
LOOP = REPOSITORY / "tests/rtl/loop"
FRAME = 480 * 640
INTERVAL_US = 100_000
STATUS, IDENTITY = 0x14, 0x10C  # of cm_control.v
PARTS = {"zynq7000": (0x03727093, "intc"), "zynqmp": (0x04A49093, "gic")}  # XC7Z020, XCK26: their IDCODE


@dataclass(frozen=True, slots=True)
class Design:
    """A shipped example, or another one, for a board."""

    name: str
    platform: str
    base: int  # of its control registers
    change: Callable[[dict[str, Any]], None]  # of its build schema
    example: Path = EXAMPLE


def _as_shipped(schema: dict[str, Any]) -> None:
    """For the board that the example is for."""


def _on_kv260(schema: dict[str, Any]) -> None:
    """The KV260 has no header for the example's sensor: the same without its pins."""
    schema["project"]["board"] = "kv260"
    region = schema["regions"]["prr0"]
    region["pblock"] = "auto"
    region["resources"] = {"lut": 2000, "ff": 3000, "bram": 4}
    for name in ("s_axis", "lens_focus", "lens_zoom"):
        region["interfaces"][name] = {"connect": "none"}


def _coherent(schema: dict[str, Any]) -> None:
    """Behind a port that snoops the processors' caches."""
    _on_kv260(schema)
    schema["static"] = {"coherent": True}


def _shared(schema: dict[str, Any]) -> None:
    """Nine loops: four on an MCDMA, five with both channels of an engine; a VDMA; and more channels than lines."""
    names = [f"r{number}" for number in range(9)]
    schema["project"] = {"name": "shared", "board": "kv260"}
    schema["clocks"] = {"fclk0": {"rate": 100_000_000}}
    schema["regions"] = {
        name: {
            "interfaces": {
                pin: {"stream": f"{way}_{name}", "engine": "all" if number < 4 else f"loop{number}"}
                for pin, way in (("s_axis", "to"), ("m_axis", "from"))
            }
        }
        for number, name in enumerate(names)
    }
    schema["regions"]["video"] = {"interfaces": {"m_axis": {"stream": "video", "connect": "vdma", "shape": [480, 640]}}}
    schema["modules"] = {
        "loop": {"regions": names, "sources": ["hdl/loop.v"]},
        "frames": {"regions": ["video"], "sources": ["hdl/frames.v"]},
    }
    schema["modes"] = {"all": {"modules": {**dict.fromkeys(names, "loop"), "video": "frames"}}}
    schema["default_mode"] = "all"


DESIGNS = (
    Design("camera-pynq-z2", "zynq7000", 0x40000000, _as_shipped),
    Design("camera-kv260", "zynqmp", 0xA0000000, _on_kv260),
    Design("camera-kv260-coherent", "zynqmp", 0xA0000000, _coherent),
    Design("shared-kv260", "zynqmp", 0xA0000000, _shared, LOOP),
)


# what stands at the addresses of dts/overlays/common/static.dtsi
_SG = {"c_include_sg": 1, "c_sg_length_width": 26}
DTS_ENGINES = [
    hardware.Engine("dma_camera", {**_SG, "c_include_mm2s": 0, "c_include_s2mm": 1}, 0xA0000000, {"s2mm": (0, 0)}),
    hardware.Engine(
        "dma_loop", {**_SG, "c_include_mm2s": 1, "c_include_s2mm": 1}, 0xA0010000, {"mm2s": (0, 1), "s2mm": (0, 2)}
    ),
    hardware.Engine("dma_icap", {**_SG, "c_include_mm2s": 1, "c_include_s2mm": 0}, 0xA0020000, {"mm2s": (0, 3)}),
]
DTS_PL = hardware.Pl(FRAME, INTERVAL_US, idcode=0, status=0xA0030110, identity=0xA0040010)


def folder(cache: Cache) -> Path:
    """A folder with one for each design: its runtime schema, its overlays, and its hardware for the model."""
    inputs = [REPOSITORY / "cm", LOOP, Path(__file__), Path(hardware.__file__)]
    return cache.entry("designs", inputs, _build)


def _build(place: Path) -> None:
    require("dtc")
    for design in DESIGNS:
        source = place / f"{design.name}-source"
        shutil.copytree(design.example, source)
        schema = yaml.safe_load((source / "build.yaml").read_text())
        design.change(schema)
        (source / "build.yaml").write_text(yaml.safe_dump(schema))
        run([_python(), "-m", "cm.cli.main", "build", "generate", source / "build.yaml"], cwd=REPOSITORY)
        _compile(design, source / "build", place / design.name)
        shutil.rmtree(source)
    for platform, (_, controller) in PARTS.items():
        target = place / f"dts-{platform}"
        target.mkdir()
        (target / "hardware.dtso").write_text(hardware.overlay(DTS_ENGINES, DTS_PL, platform, controller))
        _dtc(target / "hardware.dtso", target)


def _python() -> Path:
    """One that has what `cm build` imports: the project's own environment, or the one this runs in."""
    own = REPOSITORY / ".venv/bin/python"
    return own if own.exists() else Path(sys.executable)


def _dtc(source: Path, target: Path) -> None:
    run(["dtc", "-q", "-@", "-I", "dts", "-O", "dtb", "-o", target / f"{source.stem}.dtbo", source])


def _compile(design: Design, built: Path, target: Path) -> None:
    target.mkdir()
    for source in source_files(built / "config"):
        shutil.copy2(source, target)
    found = hardware.engines((built / "tcl/block_design.tcl").read_text(), (built / "hdl/cm_static.v").read_text())
    idcode, controller = PARTS[design.platform]
    pl = hardware.Pl(FRAME, INTERVAL_US, idcode, design.base + STATUS, design.base + IDENTITY)
    (target / "hardware.dtso").write_text(hardware.overlay(found, pl, design.platform, controller))
    for source in [*(built / "dts").glob("*.dtso"), target / "hardware.dtso"]:
        _dtc(source, target)

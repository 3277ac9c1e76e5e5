# SPDX-License-Identifier: Apache-2.0
"""The overlays of dts/ for boards, as they are: applied, each node bound, their bitstreams loaded, and removed.

Their trees are one here (tests/vm/trees): Zynq-7000's `fpga_full` has another label, because ZynqMP's has two cells.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from made import DESIGNS
from nodes import compatibles, drivers, expected
from plsim import nothing
from served import loads, until

from cm import device
from cm.formats import fdt
from cm.formats.bitstream import assemble_module, to_dma_words

pytestmark = pytest.mark.needs("xilinx_dma", "overlay", "fpga", "uio_genirq")
COMPILED = Path("/opt/cm/firmware")
FIRMWARE = Path("/lib/firmware/cm/camera")
PCAP = Path("/sys/kernel/debug/cm_pcap")
SECURE_ACCESS = Path("/sys/kernel/debug/cm_axi/firmware/secure_access")
BOARDS = {"zynq-7000": "zynq7000", "kv260": "zynqmp", "zcu104": "zynqmp", "ultra96": "zynqmp"}
MODULES = ("default", "edge", "colorise")


def overlay(board: str, name: str) -> bytes:
    blob = (COMPILED / board / f"{name}.dtbo").read_bytes()
    return blob if BOARDS[board] == "zynqmp" else relabelled(blob)


def relabelled(blob: bytes) -> bytes:
    """The same overlay, with `zynq_full` in place of `fpga_full`."""
    root = fdt.unpack(blob)
    fixups = root.child("__fixups__")
    if fixups is not None and "fpga_full" in fixups.properties:
        fixups.properties["zynq_full"] = fixups.properties.pop("fpga_full")
    return fdt.pack(root)


def full_loads() -> int:
    return int((PCAP / "full").read_text())


@contextmanager
def hardware(platform: str) -> Iterator[device.Overlays]:
    """The engines at the overlays' addresses."""
    overlays = device.Overlays("/")
    overlays.apply("hardware", (DESIGNS / f"dts-{platform}" / "hardware.dtbo").read_bytes())
    try:
        yield overlays
    finally:
        for name in reversed(overlays.list()):
            overlays.remove(name)


@pytest.fixture(scope="module", params=BOARDS)
def board(request: pytest.FixtureRequest) -> Iterator[str]:
    FIRMWARE.mkdir(parents=True, exist_ok=True)
    for name in (*MODULES, "static"):  # what the chip's own port gets is not looked at
        words = to_dma_words(assemble_module(name, size=16 * 1024))
        (FIRMWARE / f"{name}.bit.bin").write_bytes(words)
    with nothing(), hardware(BOARDS[request.param]):
        SECURE_ACCESS.write_text("1")
        yield request.param


@pytest.fixture
def static(board: str) -> Iterator[device.Overlays]:
    overlays = device.Overlays("/")
    blob = overlay(board, "static")
    overlays.apply("static", blob)
    until(lambda: drivers(blob) == expected(blob))
    yield overlays
    for name in reversed(overlays.list()):
        if name != "hardware":
            overlays.remove(name)


def test_the_static_overlay_loads_its_bitstream_and_each_node_is_bound(board: str, static: device.Overlays) -> None:
    blob = overlay(board, "static")
    assert len(compatibles(blob)) == 11
    assert "" not in drivers(blob).values()
    before = full_loads()
    static.remove("static")
    assert set(drivers(blob).values()) == {"no device"}
    static.apply("static", blob)
    until(lambda: drivers(blob) == expected(blob))
    assert full_loads() == before + 1


def test_the_cameras_overlay_is_bound_and_goes_again(board: str, static: device.Overlays) -> None:
    blob = overlay(board, "camera")
    static.apply("camera", blob)
    assert drivers(blob) == expected(blob)
    static.remove("camera")
    assert set(drivers(blob).values()) == {"no device"}


@pytest.mark.parametrize("module", MODULES)
def test_a_modules_overlay_loads_it_through_the_port_and_is_bound(
    board: str, static: device.Overlays, module: str
) -> None:
    blob = overlay(board, module)
    before = loads()
    static.apply("module", blob)
    assert loads() == before + 1
    assert drivers(blob) == expected(blob)
    static.remove("module")
    assert set(drivers(blob).values()) == {"no device"}

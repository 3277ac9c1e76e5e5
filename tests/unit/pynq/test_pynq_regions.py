# SPDX-License-Identifier: Apache-2.0
"""Hierarchies, and partial bitstreams by `pr_download`, on a simulated board."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from bitstream_support import frames
from import_support import bitstream, described, hwh, memory, memory_range, module, port, ports, register
from manager_process import Manager, served, short_folder, until

from cm import pynq
from cm.errors import NotFound
from cm.formats.bitstream import FrameAddress, FrameRun, assemble
from cm.formats.importers import import_pynq, write
from cm.pynq.board import board, places

GAIN = described(register("GAIN", 0x10))


def inside(path: str, kind: str, registers: str) -> str:
    """A block in a hierarchy: its instance has underscores, its path slashes."""
    instance = path.replace("/", "_")
    return module(instance, kind, registers).replace(f'FULLNAME="/{instance}"', f'FULLNAME="/{path}"')


def design() -> bytes:
    """A filter in two hierarchies, and a region behind a decoupler that a GPIO drives."""
    windows = (("video_in_filter", 0x40000000, 0x1000), ("gpio", 0x41200000, 0x1000), ("pr_0", 0x43C00000, 0x1000))
    return hwh(
        module("ps", "processing_system7", memory(*windows)),
        inside("video/in/filter", "filter", GAIN),
        module("gpio", "axi_gpio"),
        module(
            "dec", "dfx_decoupler", ports(port("decouple", "I", ("gpio", "gpio_io_o")), port("rp", "I", ("pr_0", "x")))
        ),
        module("pr_0", "rm", region=True),
    )


def partial(name: str) -> bytes:
    external = f"<BUSINTERFACE><MEMORYMAP>{memory_range('acc', 0, 0x1000)}</MEMORYMAP></BUSINTERFACE>"
    return hwh(module("acc", "acc", described(register(name, 0x10))), external=external, design=name)


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with short_folder() as found:
        (found / "top.bit").write_bytes(bitstream())
        (found / "top.hwh").write_bytes(design())
        for name in ("pr_0_edge", "pr_0_zoom"):
            run = FrameRun(FrameAddress(0, 0, 3), frames(1, seed=name.encode()))
            (found / f"{name}.bit").write_bytes(assemble("xc7z020", [run], partial=True))
            (found / f"{name}.hwh").write_bytes(partial(name))
        write(import_pynq(found / "top.bit"), found)
        yield found


@pytest.fixture(scope="module")
def manager(folder: Path) -> Iterator[Manager]:
    with served(schemas=folder) as (found, _):
        yield found


@pytest.fixture
def overlay(manager: Manager, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[pynq.Overlay]:
    monkeypatch.setenv("CM_CONNECT", str(manager.runtime))
    yield pynq.Overlay(str(folder / "top.bit"))
    board().close()
    board.cache_clear()
    places.cache_clear()


def test_blocks_lie_in_their_hierarchies(overlay: pynq.Overlay) -> None:
    assert list(overlay.ip_dict) == ["video/in/filter", "gpio", "pr_0"]
    assert sorted(overlay.hierarchy_dict) == ["video", "video/in"]
    found = getattr(overlay.video, "in").filter
    found.register_map.GAIN = 4
    assert board().registers["video_in_filter_gain"] == 4


def test_a_hierarchy_has_the_class_that_accepts_it(overlay: pynq.Overlay) -> None:
    class Input(pynq.DefaultHierarchy):
        @staticmethod
        def checkhierarchy(description: pynq.overlay.Description) -> bool:
            return "filter" in description["ip"]

    try:
        assert type(getattr(overlay.video, "in")) is Input
        assert type(overlay.video) is pynq.DefaultHierarchy
    finally:
        pynq.DefaultHierarchy.drivers.remove(Input)


def test_a_partial_bitstream_is_loaded_into_its_region(overlay: pynq.Overlay) -> None:
    window = pynq.MMIO(0x43C00000, 0x1000)
    for name in ("pr_0_edge", "pr_0_zoom"):
        overlay.pr_download("pr_0", f"{name}.bit")
        assert (board().mode, board().regions["pr_0"].module) == (name, name)
        window.write(0x10, 5)
        assert window.read(0x10) == 5
        (there,) = [one for one in board().registers.info if one.startswith("pr_0")]
        assert (name in there, board().registers[there]) == (True, 5)


@pytest.mark.parametrize(("region", "bit"), [("pr_1", "pr_0_edge.bit"), ("pr_0", "other.bit")])
def test_a_region_or_bitstream_that_is_not_there_is_named(overlay: pynq.Overlay, region: str, bit: str) -> None:
    with pytest.raises(NotFound, match=r"pr_1|other"):
        overlay.pr_download(region, bit)


def test_another_program_that_changes_the_mode_changes_what_lies_at_an_address(
    overlay: pynq.Overlay, manager: Manager
) -> None:
    overlay.pr_download("pr_0", "pr_0_edge.bit")
    window = pynq.MMIO(0x43C00000, 0x1000)
    window.write(0x10, 5)
    with manager.connected() as other:
        other.mode = "pr_0_zoom"
        (there,) = [one for one in other.registers.info if one.startswith("pr_0")]
        other.registers[there] = 6
        assert until(lambda: window.read(0x10) == 6)  # the status tells it, some time later

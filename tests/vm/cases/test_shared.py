# SPDX-License-Identifier: Apache-2.0
"""Engines that streams share, as `cm build generate` made them, under the kernel's own driver.

Nine looped regions: four on one MCDMA, five with both channels of an AXI DMA; one that makes video, behind a VDMA; and
interrupts of several channels on one line, which nothing but the driver tells apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from made import Design, design
from nodes import drivers, expected
from plsim import nothing
from served import PATIENCE, until

from cm import device
from cm.formats import fdt

pytestmark = pytest.mark.needs("xilinx_dma", "overlay", "fpga", "uio_genirq")
REGIONS = [f"r{number}" for number in range(9)]
FRAME = 4096


@pytest.fixture(scope="module")
def made() -> Iterator[Design]:
    with nothing(), design("shared-kv260") as there:
        yield there


@pytest.fixture(scope="module")
def applied(made: Design) -> Iterator[device.Overlays]:
    overlays = device.Overlays("/")
    overlays.apply(made.static, made.overlay(made.static))
    until(lambda: drivers(made.overlay(made.static)) == expected(made.overlay(made.static)))
    yield overlays
    overlays.remove(made.static)


def words(start: int) -> np.ndarray:
    return np.arange(start, start + FRAME // 4, dtype="<u4").view(np.uint8)


def lines(made: Design) -> list[tuple[int, ...]]:
    """Interrupts of each direction of each engine."""
    found = []
    for path, node in fdt.unpack(made.overlay(made.static)).walk():
        if "dma-channel" in path and "interrupts" in node.properties:
            cells = np.frombuffer(node.properties["interrupts"], ">u4")
            found.append(tuple(int(spi) for spi in cells[1::3]))
    return found


def test_every_stream_is_a_channel_of_its_own(made: Design, applied: device.Overlays) -> None:
    names = {f"{way}_{region}" for region in REGIONS for way in ("to", "from")}
    assert set(device.list_dma()) == {*names, "video"}
    for name in names:
        with device.AxiDma.open(name) as channel:
            assert channel.info.direction.name == ("MM2S" if name.startswith("to") else "S2MM")


def test_several_channels_share_a_line(made: Design, applied: device.Overlays) -> None:
    used = [spi for group in lines(made) for spi in group]
    assert len(set(used)) < len(used)
    assert max(len(group) for group in lines(made)) == 4  # the MCDMA's


def test_frames_of_all_regions_at_once_come_back_on_their_own_channels(made: Design, applied: device.Overlays) -> None:
    senders = {name: device.AxiDma.open(f"to_{name}") for name in REGIONS}
    receivers = {name: device.AxiDma.open(f"from_{name}") for name in REGIONS}
    rooms = {name: channel.allocate(3 * FRAME) for name, channel in receivers.items()}
    data = {name: channel.allocate(3 * FRAME) for name, channel in senders.items()}
    try:
        for index in range(3):
            for name in REGIONS:
                receivers[name].submit(rooms[name], index * FRAME, FRAME, cookie=index)
        for index in range(3):
            for number, name in enumerate(REGIONS):
                data[name].array(index * FRAME, FRAME, writable=True)[:] = words(100_000 * number + 5000 * index)
                senders[name].submit(data[name], index * FRAME, FRAME, cookie=index)
        for number, name in enumerate(REGIONS):
            for index in range(3):
                sent, got = senders[name].wait(PATIENCE), receivers[name].wait(PATIENCE)
                assert (sent.cookie, sent.status) == (index, 0)
                assert (got.cookie, got.status, got.length) == (index, 0, FRAME)
                there = rooms[name].array(index * FRAME, FRAME)
                assert np.array_equal(there, words(100_000 * number + 5000 * index)), (name, index)
    finally:
        for opened in (*rooms.values(), *data.values(), *senders.values(), *receivers.values()):
            opened.close()


def test_frames_of_a_region_behind_a_vdma_are_those_that_the_schema_names(
    made: Design, applied: device.Overlays
) -> None:
    """One after another as its camera gives them: each begins with its number, and counts up."""
    rows, columns = made.config["streams"]["video"]["shape"]
    with device.AxiDma.open("video") as channel, channel.allocate(rows * columns) as room:
        assert device.DmaCaps.VIDEO in channel.info.caps
        before = -1
        for cookie in range(3):
            channel.submit_video(room, rows, columns, columns, cookie=cookie)
            done = channel.wait(PATIENCE)
            assert (done.cookie, done.status, done.length) == (cookie, 0, rows * columns)
            got = room.array(0, rows * columns).view("<u4")
            assert int(got[0]) > before
            assert np.array_equal(got, np.arange(got[0], got[0] + got.size, dtype="<u4"))
            before = int(got[0])


def test_closing_a_channel_leaves_those_that_share_its_engine_what_they_wait_for(
    made: Design, applied: device.Overlays
) -> None:
    for stays, goes in (("r0", "r1"), ("r4", "r4")):
        with device.AxiDma.open(f"from_{stays}") as kept, kept.allocate(FRAME) as room:
            kept.submit(room, length=FRAME)
            with device.AxiDma.open(f"to_{goes}") as other:
                other.cancel()
            with device.AxiDma.open(f"to_{stays}") as sender, sender.allocate(FRAME) as data:
                data.array(writable=True)[:] = words(7)
                sender.submit(data, length=FRAME)
                assert kept.wait(PATIENCE).status == 0
            assert np.array_equal(room.array(), words(7))


def test_nothing_is_left_of_shared_engines_when_their_overlay_goes(made: Design, applied: device.Overlays) -> None:
    blob = made.overlay(made.static)
    applied.remove(made.static)
    assert set(drivers(blob).values()) == {"no device"}
    assert not list(Path("/dev/cm_dma").glob("*")) if Path("/dev/cm_dma").exists() else True
    applied.apply(made.static, blob)
    until(lambda: drivers(blob) == expected(blob))

# SPDX-License-Identifier: Apache-2.0
"""A 32-bit board whose CMA area is in high memory: buffers come from it by the coherent interface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from served import PATIENCE

from cm import device

pytestmark = pytest.mark.needs("highmem")
LARGE = 16 << 20  # more than the buddy allocator has in one piece: out of the CMA area alone


def allocated() -> int:
    return int(Path("/sys/kernel/debug/cm_dma/allocated").read_text())


def cma_free() -> int:
    lines = Path("/proc/meminfo").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("CmaFree:")) << 10


def test_a_large_buffer_comes_from_the_cma_area_and_goes_back_to_it() -> None:
    before, free = allocated(), cma_free()
    with device.AxiDma.open("to_pl") as channel:
        with channel.allocate(LARGE) as buffer:
            assert buffer.coherent  # needs no SYNC: it is not cached
            assert allocated() == before + LARGE
            assert cma_free() < free  # not by all of it: what had been lent out of the area was moved away
        assert allocated() == before


def test_frames_in_it_go_there_and_back() -> None:
    out, back = device.AxiDma.open("to_pl"), device.AxiDma.open("from_pl")
    with out, back, out.allocate(LARGE) as source, back.allocate(LARGE) as sink:
        for turn, length in enumerate((64, 4096, 1 << 20)):
            frame = np.random.default_rng(turn).integers(0, 256, length, np.uint8)
            source.array(0, length)[:] = frame
            back.submit(sink, length=length)
            out.submit(source, length=length)
            assert (back.wait(PATIENCE).length, out.wait(PATIENCE).status) == (length, 0)
            assert np.array_equal(sink.array(0, length), frame)

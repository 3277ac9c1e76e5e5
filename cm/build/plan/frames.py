# SPDX-License-Identifier: Apache-2.0
"""Whether the frames that a build schema describes can be what a stream carries."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from cm.build.plan.engines import Dma, EngineKind
from cm.build.plan.system import StreamBus

MAX_LINES, MAX_LINE = (1 << 13) - 1, (1 << 16) - 1  # of a VDMA: VSIZE, HSIZE (xaxivdma_hw.h of Xilinx/embeddedsw)


def item_bytes(dtype: str) -> int:
    """Bytes of an element: ``uint16`` has 2, ``complex64`` 8, ``bool`` 1."""
    bits = re.search(r"\d+$", dtype)
    return int(bits[0]) // 8 if bits else 1


def frame_problem(bus: StreamBus, shape: Sequence[int] | None, dtype: str | None) -> tuple[str, str] | None:
    """What is wrong with frames of `shape` × `dtype` on this stream, and what would be right; else None."""
    if bus.dma is None or not shape:
        return None
    if bus.dma.kind is EngineKind.VDMA:
        return _video_problem(bus.dma, shape, dtype or bus.spec.dtype)
    size = math.prod(shape) * item_bytes(dtype or bus.spec.dtype)
    text = f"a frame of {'×'.join(map(str, shape))} {dtype or bus.spec.dtype} has {size:_} bytes"
    limit = bus.spec.max_length or (1 << bus.dma.length_bits) - 1
    if size > limit:
        key = "max_length" if bus.spec.max_length else "the DMA's length register"
        return f"{text}, {key} allows {limit:_}", "send it in parts, or make it smaller"
    beat = bus.bytes
    if size % beat and "TKEEP" not in bus.interface.ports:
        hint = f"give {bus.interface.name} a TKEEP, or write a shape of whole beats"
        return f"{text}: no whole number of the {beat} bytes of a beat, and there is no TKEEP to say so", hint
    return None


def _video_problem(dma: Dma, shape: Sequence[int], dtype: str) -> tuple[str, str] | None:
    """What a VDMA cannot do: without realignment lines are whole words of its way to memory (AR 54934)."""
    lines, line = shape[0], math.prod(shape[1:]) * item_bytes(dtype)
    beat, word = dma.width // 8, dma.memory_width // 8
    if len(shape) < 2:
        return "a VDMA's frames have lines and columns", "write shape: [lines, columns], with dtype"
    if lines > MAX_LINES or line > MAX_LINE:
        return f"{lines:_} lines of {line:_} bytes", f"a VDMA takes {MAX_LINES} lines of {MAX_LINE} bytes"
    if line % math.lcm(beat, word):
        return f"a line has {line:_} bytes", f"a VDMA's lines are multiples of {math.lcm(beat, word)} bytes here"
    return None

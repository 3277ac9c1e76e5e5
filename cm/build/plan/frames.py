# SPDX-License-Identifier: Apache-2.0
"""Whether the frames that a build schema describes can be what a stream carries."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from cm.build.plan.system import StreamBus


def item_bytes(dtype: str) -> int:
    """Bytes of an element: ``uint16`` has 2, ``complex64`` 8, ``bool`` 1."""
    bits = re.search(r"\d+$", dtype)
    return int(bits[0]) // 8 if bits else 1


def frame_problem(bus: StreamBus, shape: Sequence[int] | None, dtype: str | None) -> tuple[str, str] | None:
    """What is wrong with frames of `shape` × `dtype` on this stream, and what would be right; else None."""
    if bus.dma is None or not shape:
        return None
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

# SPDX-License-Identifier: Apache-2.0
"""What a frame's synchronisation costs where DMA memory is not coherent with the caches (HP ports of a Zynq)."""

from __future__ import annotations

from contextlib import ExitStack

from cm.device import AxiDma, DeviceError, Direction, DmaBuffer, list_dma
from cm.tools.bench.result import Result, unavailable
from cm.tools.bench.rounds import beside, interleave, timed
from cm.tools.bench.run import IMAGE, Run

NAME = "frame_sync"
RAN = (
    "DMA_BUF_IOCTL_SYNC at the beginning and end of a read of a buffer of 3.96 MiB, on the first free S2MM channel "
    "of this machine ($CM_ROOT); baseline: the same with 64 KiB"
)
SMALL = 64 << 10


def run(bench: Run) -> list[Result]:
    """Measure `frame_sync`."""
    with ExitStack() as stack:
        channel = _channel(stack)
        if channel is None:
            return [unavailable(NAME, "µs", RAN, "this machine has no free S2MM channel of cm_dma")]
        image, small = (stack.enter_context(channel.allocate(length)) for length in (IMAGE, SMALL))
        if image.coherent:
            why = f"the memory of channel {channel.info.name} is coherent: nothing is synchronised"
            return [unavailable(NAME, "µs", RAN, why)]
        samples = interleave(
            {"image": timed(lambda: _read(image)), "small": timed(lambda: _read(small))}, bench.plan(100)
        )
    return [beside(NAME, RAN, samples["image"], samples["small"])]


def _channel(stack: ExitStack) -> AxiDma | None:
    for name in list_dma():
        try:
            channel = stack.enter_context(AxiDma.open(name))
        except DeviceError:
            continue
        if channel.info.direction is Direction.S2MM:
            return channel
    return None


def _read(buffer: DmaBuffer) -> None:
    buffer.sync_begin(write=False)
    buffer.sync_end(write=False)

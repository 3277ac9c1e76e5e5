# SPDX-License-Identifier: Apache-2.0
"""Classes for blocks of AMD's, by their VLNV: `AxiGPIO`, `DMA`."""

from __future__ import annotations

from typing import Any

from cm.pynq.lib.axigpio import AxiGPIO
from cm.pynq.lib.dma import DMA
from cm.pynq.overlay import DefaultIP

__all__ = ["DMA", "AxiGPIO", "AxiIIC"]


class AxiIIC(DefaultIP):
    """An AXI IIC. Its `send`, `receive` and `wait` raise NotImplementedError."""

    bindto = ("xilinx.com:ip:axi_iic:2.1",)

    def send(self, *_: Any) -> int:
        """Not possible."""
        raise NotImplementedError("an AXI IIC is the kernel's (i2c-xiic): /dev/i2c-N, for the users who may open it")

    receive = wait = send


def __getattr__(name: str) -> Any:
    if name.startswith("_") or name.islower():  # submodules are looked for by import
        raise AttributeError(f"module 'pynq.lib' has no attribute {name!r}")
    raise ImportError(
        f"pynq.lib.{name} is not here: of pynq.lib there are AxiGPIO and DMA, and neither video, audio, boards' "
        "peripherals nor MicroBlaze (docs/pynq.md)"
    )

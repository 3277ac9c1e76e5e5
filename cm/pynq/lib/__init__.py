# SPDX-License-Identifier: Apache-2.0
"""Classes for blocks of AMD's, by their VLNV: `AxiGPIO`, `DMA`."""

from __future__ import annotations

from typing import Any

from cm.pynq.lib.axigpio import AxiGPIO
from cm.pynq.lib.dma import DMA

__all__ = ["DMA", "AxiGPIO"]


def __getattr__(name: str) -> Any:
    if name.startswith("_") or name.islower():  # submodules are looked for by import
        raise AttributeError(f"module 'pynq.lib' has no attribute {name!r}")
    raise ImportError(
        f"pynq.lib.{name} is not here: of pynq.lib there are AxiGPIO and DMA, and neither video, audio, boards' "
        "peripherals nor MicroBlaze (docs/pynq.md)"
    )

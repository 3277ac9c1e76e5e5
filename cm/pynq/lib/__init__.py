# SPDX-License-Identifier: Apache-2.0
"""Classes for blocks of AMD's, by their VLNV: `AxiGPIO`, `DMA`."""

from __future__ import annotations

from functools import partial

from cm.pynq.alias import absent
from cm.pynq.lib.axigpio import AxiGPIO as AxiGPIO
from cm.pynq.lib.dma import DMA as DMA

__getattr__ = partial(absent, "pynq.lib")

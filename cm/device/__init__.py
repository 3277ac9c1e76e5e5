# SPDX-License-Identifier: Apache-2.0
"""Devices of a board, real or simulated: registers, DMA channels, configuration ports, overlays.

Usable without the manager.  Open devices are context managers; ``docs/device.md`` is the guide.
"""

from __future__ import annotations

import cm.device.native  # noqa: F401 (first: where there are no devices it says so)
from cm.device.axidma import AxiDma, Completion, Direction, DmaCaps, DmaInfo, DmaType, list_dma
from cm.device.buffer import DmaBuffer
from cm.device.clocks import PlClock, PlClocks
from cm.device.errors import (
    DeviceBusy,
    DeviceClosed,
    DeviceError,
    DeviceExists,
    DeviceGone,
    DeviceInvalid,
    DeviceNotFound,
    DevicePermission,
    DeviceTimeout,
    DeviceUnsupported,
)
from cm.device.fpga_manager import FpgaManager, list_fpga_managers
from cm.device.gpio import GpioChip, GpioLine, list_gpio
from cm.device.icap import Icap, IcapCompletion, IcapErrors, IcapInfo, IcapState, IcapStatus, list_icap
from cm.device.overlays import Overlays
from cm.device.paths import Root
from cm.device.sensors import Reading, read_sensors
from cm.device.uio import Uio, UioInfo, UioMap, find_uio, list_uio

__all__ = [
    "AxiDma",
    "Completion",
    "DeviceBusy",
    "DeviceClosed",
    "DeviceError",
    "DeviceExists",
    "DeviceGone",
    "DeviceInvalid",
    "DeviceNotFound",
    "DevicePermission",
    "DeviceTimeout",
    "DeviceUnsupported",
    "Direction",
    "DmaBuffer",
    "DmaCaps",
    "DmaInfo",
    "DmaType",
    "FpgaManager",
    "GpioChip",
    "GpioLine",
    "Icap",
    "IcapCompletion",
    "IcapErrors",
    "IcapInfo",
    "IcapState",
    "IcapStatus",
    "Overlays",
    "PlClock",
    "PlClocks",
    "Reading",
    "Root",
    "Uio",
    "UioInfo",
    "UioMap",
    "find_uio",
    "list_dma",
    "list_fpga_managers",
    "list_gpio",
    "list_icap",
    "list_uio",
    "read_sensors",
]

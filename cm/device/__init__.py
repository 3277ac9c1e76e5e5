# SPDX-License-Identifier: Apache-2.0
"""Devices of a board, real or simulated: registers, DMA channels, configuration ports, overlays.

Usable without the manager.  Open devices are context managers; ``docs/device.md`` is the guide.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import cm.device.native  # noqa: F401 (first: where there are no devices it says so)

if TYPE_CHECKING:
    from cm.device.axidma import AxiDma as AxiDma
    from cm.device.axidma import Completion as Completion
    from cm.device.axidma import Direction as Direction
    from cm.device.axidma import DmaCaps as DmaCaps
    from cm.device.axidma import DmaInfo as DmaInfo
    from cm.device.axidma import DmaType as DmaType
    from cm.device.axidma import list_dma as list_dma
    from cm.device.buffer import DmaBuffer as DmaBuffer
    from cm.device.clocks import PlClock as PlClock
    from cm.device.clocks import PlClocks as PlClocks
    from cm.device.errors import DeviceBusy as DeviceBusy
    from cm.device.errors import DeviceClosed as DeviceClosed
    from cm.device.errors import DeviceError as DeviceError
    from cm.device.errors import DeviceExists as DeviceExists
    from cm.device.errors import DeviceGone as DeviceGone
    from cm.device.errors import DeviceInvalid as DeviceInvalid
    from cm.device.errors import DeviceNotFound as DeviceNotFound
    from cm.device.errors import DevicePermission as DevicePermission
    from cm.device.errors import DeviceRevoked as DeviceRevoked
    from cm.device.errors import DeviceTimeout as DeviceTimeout
    from cm.device.errors import DeviceUnsupported as DeviceUnsupported
    from cm.device.fpga_manager import FpgaManager as FpgaManager
    from cm.device.fpga_manager import list_fpga_managers as list_fpga_managers
    from cm.device.gpio import GpioChip as GpioChip
    from cm.device.gpio import GpioLine as GpioLine
    from cm.device.gpio import list_gpio as list_gpio
    from cm.device.icap import Icap as Icap
    from cm.device.icap import IcapCompletion as IcapCompletion
    from cm.device.icap import IcapErrors as IcapErrors
    from cm.device.icap import IcapInfo as IcapInfo
    from cm.device.icap import IcapState as IcapState
    from cm.device.icap import IcapStatus as IcapStatus
    from cm.device.icap import list_icap as list_icap
    from cm.device.overlays import Overlays as Overlays
    from cm.device.paths import Root as Root
    from cm.device.register_window import Grant as Grant
    from cm.device.register_window import MappedWindow as MappedWindow
    from cm.device.register_window import WindowEnd as WindowEnd
    from cm.device.register_window import WindowEvent as WindowEvent
    from cm.device.register_window import Windows as Windows
    from cm.device.sensors import Reading as Reading
    from cm.device.sensors import read_sensors as read_sensors
    from cm.device.uio import Uio as Uio
    from cm.device.uio import UioInfo as UioInfo
    from cm.device.uio import UioMap as UioMap
    from cm.device.uio import find_uio as find_uio
    from cm.device.uio import list_uio as list_uio

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
    "DeviceRevoked",
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
    "Grant",
    "Icap",
    "IcapCompletion",
    "IcapErrors",
    "IcapInfo",
    "IcapState",
    "IcapStatus",
    "MappedWindow",
    "Overlays",
    "PlClock",
    "PlClocks",
    "Reading",
    "Root",
    "Uio",
    "UioInfo",
    "UioMap",
    "WindowEnd",
    "WindowEvent",
    "Windows",
    "find_uio",
    "list_dma",
    "list_fpga_managers",
    "list_gpio",
    "list_icap",
    "list_uio",
    "read_sensors",
]

_HOMES = {
    "axidma": ("AxiDma", "Completion", "Direction", "DmaCaps", "DmaInfo", "DmaType", "list_dma"),
    "buffer": ("DmaBuffer",),
    "clocks": ("PlClock", "PlClocks"),
    "errors": (
        "DeviceBusy",
        "DeviceClosed",
        "DeviceError",
        "DeviceExists",
        "DeviceGone",
        "DeviceInvalid",
        "DeviceNotFound",
        "DevicePermission",
        "DeviceRevoked",
        "DeviceTimeout",
        "DeviceUnsupported",
    ),
    "fpga_manager": ("FpgaManager", "list_fpga_managers"),
    "gpio": ("GpioChip", "GpioLine", "list_gpio"),
    "icap": ("Icap", "IcapCompletion", "IcapErrors", "IcapInfo", "IcapState", "IcapStatus", "list_icap"),
    "overlays": ("Overlays",),
    "paths": ("Root",),
    "sensors": ("Reading", "read_sensors"),
    "uio": ("Uio", "UioInfo", "UioMap", "find_uio", "list_uio"),
    "register_window": ("Grant", "MappedWindow", "WindowEnd", "WindowEvent", "Windows"),
}
_MODULES = {name: module for module, names in _HOMES.items() for name in names}


if not TYPE_CHECKING:  # to a type checker it would allow any name

    def __getattr__(name: str) -> Any:
        """What is not used is not imported: a client's data connection needs the shim alone."""
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)

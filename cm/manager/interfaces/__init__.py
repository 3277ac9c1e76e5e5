# SPDX-License-Identifier: Apache-2.0
"""What the manager is given: devices, files, a data plane, the time and an observer. Protocols only.

`cm.device` has all that is asked for here, and `cm.server.host` puts it together; nothing of either is imported, so
the manager runs, and is tested, where no shim was compiled.
"""

from cm.manager.interfaces.board import Clocks, Devices, OutputLine, OverlayFolder, PlClock
from cm.manager.interfaces.files import Files, Image
from cm.manager.interfaces.loading import ConfigPort, KernelLoader, PortBuffer, PortCompletion, PortInfo, PortStatus
from cm.manager.interfaces.registers import AddressRange, RegisterDevice, Window
from cm.manager.interfaces.surroundings import DataPlane, Observer, TimeSource

__all__ = [
    "AddressRange",
    "Clocks",
    "ConfigPort",
    "DataPlane",
    "Devices",
    "Files",
    "Image",
    "KernelLoader",
    "Observer",
    "OutputLine",
    "OverlayFolder",
    "PlClock",
    "PortBuffer",
    "PortCompletion",
    "PortInfo",
    "PortStatus",
    "RegisterDevice",
    "TimeSource",
    "Window",
]

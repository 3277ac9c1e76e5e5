# SPDX-License-Identifier: Apache-2.0
"""The hardware handoff file (`.hwh`) that Vivado writes beside a design: what is in the block design.

`read` gives it as frozen data; the other functions answer what a runtime asks of it. Used by
`cm import pynq` and by `cm build collect`.
"""

from cm.hwh.known import registers as registers
from cm.hwh.model import BusInterface as BusInterface
from cm.hwh.model import ConnectedPort as ConnectedPort
from cm.hwh.model import Hwh as Hwh
from cm.hwh.model import InstancePort as InstancePort
from cm.hwh.model import MemoryRange as MemoryRange
from cm.hwh.model import ModuleInstance as ModuleInstance
from cm.hwh.model import RegisterField as RegisterField
from cm.hwh.model import RegisterInfo as RegisterInfo
from cm.hwh.reader import HwhError as HwhError
from cm.hwh.reader import parse as parse
from cm.hwh.reader import read as read
from cm.hwh.trace import ClockInfo as ClockInfo
from cm.hwh.trace import DecouplerInfo as DecouplerInfo
from cm.hwh.trace import DmaChannel as DmaChannel
from cm.hwh.trace import InterruptLine as InterruptLine
from cm.hwh.trace import clocks as clocks
from cm.hwh.trace import decouplers as decouplers
from cm.hwh.trace import dma_channels as dma_channels
from cm.hwh.trace import interrupts as interrupts
from cm.hwh.trace import memories as memories
from cm.hwh.trace import windows as windows

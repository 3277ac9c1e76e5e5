# SPDX-License-Identifier: Apache-2.0
"""The hardware handoff file (`.hwh`) that Vivado writes beside a design: what is in the block design.

`read` gives it as frozen data; the other functions answer what a runtime asks of it. Used by
`cm import pynq` and by `cm build collect`.
"""

from cm.formats.hwh.reader import ConnectedPort as ConnectedPort
from cm.formats.hwh.reader import Hwh as Hwh
from cm.formats.hwh.reader import HwhError as HwhError
from cm.formats.hwh.reader import MemoryRange as MemoryRange
from cm.formats.hwh.reader import ModuleInstance as ModuleInstance
from cm.formats.hwh.reader import parse as parse
from cm.formats.hwh.reader import read as read
from cm.formats.hwh.trace import DecouplerInfo as DecouplerInfo
from cm.formats.hwh.trace import DmaChannel as DmaChannel
from cm.formats.hwh.trace import InterruptLine as InterruptLine
from cm.formats.hwh.trace import clocks as clocks
from cm.formats.hwh.trace import decouplers as decouplers
from cm.formats.hwh.trace import dma_channels as dma_channels
from cm.formats.hwh.trace import interrupt_controllers as interrupt_controllers
from cm.formats.hwh.trace import interrupts as interrupts
from cm.formats.hwh.trace import memories as memories
from cm.formats.hwh.trace import processor as processor
from cm.formats.hwh.trace import raw as raw
from cm.formats.hwh.trace import registers as registers
from cm.formats.hwh.trace import stream_ends as stream_ends
from cm.formats.hwh.trace import windows as windows

# SPDX-License-Identifier: Apache-2.0
"""Words, registers and commands of the configuration logic (UG470 table 5-23, UG570 table 9-19)."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

SYNC: Final = 0xAA995566
NOP: Final = 0x20000000
DUMMY: Final = 0xFFFFFFFF
BUS_WIDTH_SYNC: Final = 0x000000BB
BUS_WIDTH_DETECT: Final = 0x11220044
TYPE1_LIMIT: Final = 0x7FF  # words a type 1 packet can carry


class Register(IntEnum):
    """Configuration registers that a bitstream writes."""

    CRC = 0
    FAR = 1
    FDRI = 2
    CMD = 4
    CTL0 = 5
    MASK = 6
    LOUT = 8
    COR0 = 9
    MFWR = 10
    CBC = 11
    IDCODE = 12
    AXSS = 13
    COR1 = 14
    WBSTAR = 16
    TIMER = 17
    RBCRC_SW = 19
    CTL1 = 24
    DWC = 26
    BSPI = 31


class Command(IntEnum):
    """Values of CMD that stand in bitstreams; any other is refused (IPROG would restart the device)."""

    NULL = 0
    WCFG = 1
    MFW = 2
    DGHIGH = 3
    START = 5
    URAM = 6
    RCRC = 7
    AGHIGH = 8
    SWITCH = 9
    GRESTORE = 10
    SHUTDOWN = 11
    DESYNC = 13
    BSPI_READ = 18
    FALL_EDGE = 19


def type1(register: int, count: int) -> int:
    """Return the header word of a type 1 write of ``count`` words."""
    return 0x30000000 | register << 13 | count


def type2(count: int) -> int:
    """Return the header word of a type 2 write, which follows a type 1 of no words."""
    return 0x50000000 | count

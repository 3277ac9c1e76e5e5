# SPDX-License-Identifier: Apache-2.0
"""What the device suite knows of the board it runs on."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable

PATIENCE = float(os.environ.get("CM_TEST_PATIENCE", "60"))  # seconds for one step; more for an emulated board


@dataclasses.dataclass(frozen=True)
class Board:
    """Names and places on one board; what is None it does not have, and tests of it are skipped."""

    root: str = "/"
    to_pl: str | None = None  # MM2S channel that is looped ...
    from_pl: str | None = None  # ... to this S2MM channel
    uio: str | None = None  # UIO device with ...
    scratch: int | None = None  # ... a 32-bit register at this offset that holds what is written
    memory: tuple[int, int] | None = None  # ... and (offset, length) of memory that nothing depends on
    irq: str | None = None  # UIO device with an interrupt
    trigger: tuple[int, int] | None = None  # (offset, value): the write that raises it ...
    acknowledge: tuple[int, int] | None = None  # ... and the one that clears it, where it is a level
    lend: tuple[int, int] | None = None  # (address, offset): a page that can be lent, with such a register in it
    icap: str | None = None
    bitstream: str | None = None  # a good partial one for this device, any container
    overlay: str | None = None  # a .dtbo that this board takes
    close_waits: bool = True  # closing a port waits for the end of its load
    raise_interrupt: Callable[[], None] | None = None  # in place of `trigger`
    stall: Callable[[bool], None] | None = None  # lets a load stand still, and go on; elsewhere it has its own speed
    decouple: Callable[[bool], None] | None = None  # cuts off what is loaded, which a load would spoil otherwise

# SPDX-License-Identifier: Apache-2.0
"""PYNQ's names over the client, so that its programs run unchanged: ``python -m cm.pynq program.py``.

Nothing else imports it. What PYNQ has and this does not raises ImportError with a sentence (docs/pynq.md).
"""

from __future__ import annotations

from typing import Any

from cm.pynq.board import Clocks as Clocks
from cm.pynq.buffer import PynqBuffer as PynqBuffer
from cm.pynq.buffer import Xlnk as Xlnk
from cm.pynq.buffer import allocate as allocate
from cm.pynq.interrupt import Interrupt as Interrupt
from cm.pynq.mmio import MMIO as MMIO
from cm.pynq.overlay import PL as PL
from cm.pynq.overlay import DefaultHierarchy as DefaultHierarchy
from cm.pynq.overlay import DefaultIP as DefaultIP
from cm.pynq.overlay import Overlay as Overlay
from cm.pynq.overlay import UnsupportedConfiguration as UnsupportedConfiguration
from cm.pynq.registers import Register as Register
from cm.pynq.registers import RegisterMap as RegisterMap

_MEASURED = "board.status.sensors of cm.connect() has what the board measures"
_ELSEWHERE = {
    "GPIO": "the processor's own GPIO is the kernel's (libgpiod); decouplers on it are the manager's",
    "Device": "a program has one board, that of $CM_CONNECT or of this machine",
    "Bitstream": "Overlay loads a configuration that `cm import pynq` made",
    "DeviceTreeSegment": "the manager applies the overlays of a configuration",
    "UioController": "interrupts are the manager's",
    **dict.fromkeys(("get_rails", "DataRecorder"), _MEASURED),
}


def __getattr__(name: str) -> Any:
    if name in _ELSEWHERE:
        raise ImportError(f"pynq.{name} is not here: {_ELSEWHERE[name]}")
    raise AttributeError(f"module 'pynq' has no attribute {name!r}")


def load_ipython_extension(_: Any) -> None:
    """``%load_ext cm.pynq``: from now on ``import pynq`` means this."""
    from cm.pynq.alias import install

    install()

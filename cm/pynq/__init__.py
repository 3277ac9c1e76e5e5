# SPDX-License-Identifier: Apache-2.0
"""PYNQ's names over the client, so that its programs run unchanged: ``python -m cm.pynq program.py``.

Nothing else imports it. What PYNQ has and this does not raises ImportError with a sentence (docs/pynq.md).
"""

from __future__ import annotations

from typing import Any

from cm.pynq.buffer import PynqBuffer, Xlnk, allocate
from cm.pynq.interrupt import Interrupt
from cm.pynq.mmio import MMIO
from cm.pynq.overlay import PL, DefaultHierarchy, DefaultIP, Overlay, UnsupportedConfiguration
from cm.pynq.ps import Clocks
from cm.pynq.registers import Register, RegisterMap

__all__ = [
    "MMIO",
    "PL",
    "Clocks",
    "DefaultHierarchy",
    "DefaultIP",
    "Interrupt",
    "Overlay",
    "PynqBuffer",
    "Register",
    "RegisterMap",
    "UnsupportedConfiguration",
    "Xlnk",
    "allocate",
]

_ELSEWHERE = {
    "GPIO": "the processor's own GPIO is the kernel's (libgpiod); decouplers on it are the manager's",
    "Device": "a program has one board, that of $CM_CONNECT or of this machine",
    "Bitstream": "Overlay loads a configuration that `cm import pynq` made",
    "DeviceTreeSegment": "the manager applies the overlays of a configuration",
    "UioController": "interrupts are the manager's",
    "get_rails": "board.status.sensors of cm.connect() has what the board measures",
    "DataRecorder": "board.status.sensors of cm.connect() has what the board measures",
}


def __getattr__(name: str) -> Any:
    if name in _ELSEWHERE:
        raise ImportError(f"pynq.{name} is not here: {_ELSEWHERE[name]}")
    raise AttributeError(f"module 'pynq' has no attribute {name!r}")


def load_ipython_extension(_: Any) -> None:
    """``%load_ext cm.pynq``: from now on ``import pynq`` means this."""
    from cm.pynq.alias import install

    install()

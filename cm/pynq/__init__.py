# SPDX-License-Identifier: Apache-2.0
"""PYNQ's names over the client, so that its programs run unchanged: ``python -m cm.pynq program.py``.

Nothing else imports it. What PYNQ has and this does not raises ImportError with a sentence (docs/pynq.md).
"""

from __future__ import annotations

from functools import partial
from typing import Any

from cm.pynq import lib as lib
from cm.pynq.alias import absent, install
from cm.pynq.board import Clocks as Clocks
from cm.pynq.board import Interrupt as Interrupt
from cm.pynq.board import PynqBuffer as PynqBuffer
from cm.pynq.board import Xlnk as Xlnk
from cm.pynq.board import allocate as allocate
from cm.pynq.mmio import MMIO as MMIO
from cm.pynq.mmio import Register as Register
from cm.pynq.mmio import RegisterMap as RegisterMap
from cm.pynq.overlay import PL as PL
from cm.pynq.overlay import DefaultHierarchy as DefaultHierarchy
from cm.pynq.overlay import DefaultIP as DefaultIP
from cm.pynq.overlay import Overlay as Overlay

__getattr__ = partial(absent, "pynq")


def load_ipython_extension(_: Any) -> None:
    """``%load_ext cm.pynq``: from now on ``import pynq`` means this."""
    install()

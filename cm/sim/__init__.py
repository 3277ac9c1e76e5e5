# SPDX-License-Identifier: Apache-2.0
"""The simulated board: a process that serves device nodes under ``$CM_ROOT``.

`Board` starts one and stops it; `Control` injects faults and reads its state; `BoardSpec` derives
its hardware from runtime schemas. See ``docs/simulator.md``.
"""

from __future__ import annotations

from .board import BoardSpec
from .control import Control
from .errors import SimError
from .process import Board

__all__ = ["Board", "BoardSpec", "Control", "SimError"]

# SPDX-License-Identifier: Apache-2.0
"""The simulated board: a process that serves device nodes under ``$CM_ROOT``.

`Board` starts one and stops it; `Control` injects faults and reads its state; `BoardSpec` derives
its hardware from runtime schemas. See ``docs/simulator.md``. They are imported when they are first used: a program
that only starts a board does not pay for what the board itself needs.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cm.simulation.software.errors import SimError
    from cm.simulation.software.hardware.block_models import HlsKernel
    from cm.simulation.software.hardware.board_spec import BoardSpec
    from cm.simulation.software.hardware.models import Model
    from cm.simulation.software.process.child import Board
    from cm.simulation.software.process.control import Control

__all__ = ["Board", "BoardSpec", "Control", "HlsKernel", "Model", "SimError"]

_HOMES = {
    "Board": "process.child",
    "BoardSpec": "hardware.board_spec",
    "Control": "process.control",
    "HlsKernel": "hardware.block_models",
    "Model": "hardware.models",
    "SimError": "errors",
}


if not TYPE_CHECKING:  # to a type checker it would allow any name

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

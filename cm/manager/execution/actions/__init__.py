# SPDX-License-Identifier: Apache-2.0
"""What is done at each step of a plan: one function per kind of step, in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from cm.manager.execution.actions import mode, overlays, regions, registers
from cm.manager.execution.actions.execution import Execution
from cm.manager.state import steps as s

__all__ = ["ACTIONS", "Execution"]

ACTIONS: Mapping[type, Callable[[Execution, Any], None]] = MappingProxyType(
    {
        s.Validate: mode.validate,
        s.Quiesce: mode.quiesce,
        s.RemoveOverlay: overlays.remove,
        s.Decouple: regions.decouple,
        s.Load: regions.load,
        s.LoadStatic: regions.load_static,
        s.ApplyOverlay: overlays.apply,
        s.Recouple: regions.recouple,
        s.CheckIdentity: regions.check_identity,
        s.SetRegister: registers.write,
        s.Publish: mode.publish,
    }
)

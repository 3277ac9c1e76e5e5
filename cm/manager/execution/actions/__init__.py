# SPDX-License-Identifier: Apache-2.0
"""What is done at each step of a plan: one function per kind of step, in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from cm.manager.execution.actions import clocks, mode, overlays, regions
from cm.manager.execution.context import StepContext
from cm.manager.state import steps as s

ACTIONS: Mapping[type, Callable[[StepContext, Any], None]] = MappingProxyType(
    {
        s.Validate: mode.validate,
        s.CheckStatic: regions.check_static,
        s.Quiesce: mode.quiesce,
        s.RemoveOverlay: overlays.remove,
        s.Decouple: regions.decouple,
        s.Load: regions.load,
        s.LoadStatic: regions.load_static,
        s.ApplyOverlay: overlays.apply,
        s.Recouple: regions.recouple,
        s.CheckIdentity: regions.check_identity,
        s.SetRegister: mode.set_register,
        s.SetClock: clocks.set_clock,
        s.Publish: mode.publish,
    }
)

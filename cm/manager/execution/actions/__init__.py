# SPDX-License-Identifier: Apache-2.0
"""What is done at each step of a plan: one function per kind of step, in a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from cm.manager.execution.actions import clocks, overlays, pl
from cm.manager.execution.transaction import StepContext
from cm.manager.state import steps as s

ACTIONS: Mapping[type, Callable[[StepContext, Any], None]] = MappingProxyType(
    {
        s.Validate: pl.validate,
        s.CheckStatic: pl.check_static,
        s.Quiesce: pl.quiesce,
        s.RemoveOverlay: overlays.remove,
        s.Decouple: pl.decouple,
        s.Load: pl.load,
        s.LoadStatic: pl.load_static,
        s.ApplyOverlay: overlays.apply,
        s.Recouple: pl.recouple,
        s.CheckIdentity: pl.check_identity,
        s.SetRegister: pl.set_register,
        s.SetClock: clocks.set_clock,
        s.Publish: pl.publish,
    }
)

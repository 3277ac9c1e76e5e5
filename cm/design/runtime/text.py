# SPDX-License-Identifier: Apache-2.0
"""The runtime schema as text, with a comment wherever the user should decide something."""

from __future__ import annotations

import re
from collections.abc import Iterator

from cm.design.plan.system import System
from cm.schema import dump
from cm.schema.model import Config

_KEY = re.compile(r"( *)(?:- )?([^\s:#][^:]*):")


def runtime_text(system: System, config: Config) -> str:
    """Write `config` in normal form; each comment is above the key that it is about."""
    notes = dict(_notes(system, config))
    lines: list[str] = []
    stack: list[tuple[int, str]] = []
    for line in dump(config).splitlines():
        found = _KEY.match(line)
        if found:
            depth = len(found[1])
            stack = [entry for entry in stack if entry[0] < depth]
            stack.append((depth, found[2].strip("\"'")))
            note = notes.get(".".join(key for _, key in stack))
            if note:
                lines.append(f"{found[1]}# {note}")
        lines.append(line)
    return "\n".join(lines)


def _notes(system: System, config: Config) -> Iterator[tuple[str, str]]:
    yield "config.default_mode", f"decide: the mode after start, one of {', '.join(config.modes)}"
    if config.overlays:
        yield "config.overlays", "decide: leave out where dts/system-user.dtsi is part of the board's own device tree"
    for name, stream in config.streams.items():
        if stream.shape is None:
            text = "decide: shape (one frame) and dtype; without them frames are flat bytes of the length that arrived"
        else:
            text = "decide: shape, dtype and slots of a frame"
        yield f"config.streams.{name}", text
    for region in system.regions:
        if not region.spec.decoupling:
            yield f"config.regions.{region.name}", "not decoupled: a load may disturb what is connected to it"
    for name, module in config.modules.items():
        if module.registers and all(register.default is None for register in module.registers.values()):
            yield f"config.modules.{name}", "decide: default: of registers that a mode should set when it is entered"

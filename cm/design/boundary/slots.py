# SPDX-License-Identifier: Apache-2.0
"""Which interfaces of a region's modules belong together: by name, or if only one pairing is possible."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from cm.design.hdl.model import Interface, Mode, ModuleInfo, unique
from cm.frozen import dataclass, field


@dataclass(slots=True)
class Slot:
    """One interface of the boundary and the modules' interfaces that meet there."""

    name: str
    protocol: str
    mode: Mode
    members: dict[str, Interface] = field(default_factory=dict)  # by module

    def takes(self, interface: Interface) -> bool:
        """Same protocol and mode."""
        return self.protocol == interface.protocol and self.mode is interface.mode


@dataclass(slots=True)
class Slots:
    """All slots, notes and refusals by module."""

    slots: list[Slot] = field(default_factory=list)
    notes: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))
    refused: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))


def identifier(name: str) -> str:
    """A name as a Verilog identifier in lower case."""
    text = re.sub(r"\W", "_", name.lower(), flags=re.ASCII).strip("_")
    return text if text and not text[0].isdigit() else f"p_{text}"


def make_slots(modules: Sequence[ModuleInfo]) -> Slots:
    """Put every module's interfaces into slots."""
    result = Slots()
    for module in modules:
        rest = [item for item in module.interfaces if not _by_name(item, module, result)]
        rest = [item for item in rest if not _only_choice(item, rest, module, result)]
        for item in rest:
            name = unique(identifier(item.name), {slot.name for slot in result.slots})
            result.slots.append(Slot(name, item.protocol, item.mode, {module.name: item}))
    return result


def _by_name(interface: Interface, module: ModuleInfo, result: Slots) -> bool:
    name = identifier(interface.name)
    slot = next((slot for slot in result.slots if slot.name == name), None)
    if slot is None:
        return False
    if not slot.takes(interface):
        other = next(iter(slot.members), "")
        text = f"{interface.name} is {interface.protocol} {interface.mode.value}, but the {slot.name} of {other} is "
        result.refused[module.name].append(text + f"{slot.protocol} {slot.mode.value}")
        return True
    if module.name in slot.members:
        result.refused[module.name].append(f"{interface.name} and {slot.members[module.name].name} share a name")
        return True
    slot.members[module.name] = interface
    return True


def _only_choice(interface: Interface, rest: Sequence[Interface], module: ModuleInfo, result: Slots) -> bool:
    """Pair them if the module has exactly one such interface left, and the boundary exactly one such free slot."""
    alike = [item for item in rest if (item.protocol, item.mode) == (interface.protocol, interface.mode)]
    free = [slot for slot in result.slots if slot.takes(interface) and module.name not in slot.members]
    if len(alike) != 1 or len(free) != 1:
        if free and alike:
            known = ", ".join(slot.name for slot in free)
            text = f"{interface.name} could be any of {known}: it became an interface of its own"
            result.notes[module.name].append(f"{text}; name it alike to share one")
        return False
    free[0].members[module.name] = interface
    result.notes[module.name].append(f"{interface.name} is the region's {free[0].name}: the only one of its kind")
    return True

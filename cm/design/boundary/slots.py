# SPDX-License-Identifier: Apache-2.0
"""Which interfaces of a region's modules belong together: by name, or if only one pairing is possible."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from cm.design.hdl.model import Interface, Mode, ModuleInfo


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
    notes: dict[str, list[str]] = field(default_factory=dict)
    refused: dict[str, list[str]] = field(default_factory=dict)


def identifier(name: str) -> str:
    """A name as a Verilog identifier in lower case."""
    text = re.sub(r"\W", "_", name.lower()).strip("_")
    return text if text and not text[0].isdigit() else f"p_{text}"


def make_slots(modules: Sequence[ModuleInfo]) -> Slots:
    """Put every module's interfaces into slots."""
    result = Slots()
    for module in modules:
        rest = [item for item in module.interfaces if not _by_name(item, module, result)]
        rest = [item for item in rest if not _only_choice(item, rest, module, result)]
        for interface in rest:
            _new_slot(interface, module, result)
    return result


def _by_name(interface: Interface, module: ModuleInfo, result: Slots) -> bool:
    name = identifier(interface.name)
    slot = next((slot for slot in result.slots if slot.name == name), None)
    if slot is None:
        return False
    if not slot.takes(interface):
        other = next(iter(slot.members), "")
        text = f"{interface.name} is {interface.protocol} {interface.mode.value}, but the {slot.name} of {other} is "
        _add(result.refused, module.name, text + f"{slot.protocol} {slot.mode.value}")
        return True
    if module.name in slot.members:
        _add(result.refused, module.name, f"{interface.name} and {slot.members[module.name].name} share a name")
        return True
    slot.members[module.name] = interface
    return True


def _only_choice(interface: Interface, rest: Sequence[Interface], module: ModuleInfo, result: Slots) -> bool:
    """Pair them if the module has exactly one such interface left, and the boundary exactly one such free slot."""
    alike = [item for item in rest if (item.protocol, item.mode) == (interface.protocol, interface.mode)]
    free = [slot for slot in result.slots if slot.takes(interface) and module.name not in slot.members]
    if len(alike) != 1 or len(free) != 1:
        if free and alike:
            text = (
                f"{interface.name} could be any of {', '.join(slot.name for slot in free)}: it became an interface of"
            )
            _add(result.notes, module.name, f"{text} its own; name it alike to share one")
        return False
    free[0].members[module.name] = interface
    _add(result.notes, module.name, f"{interface.name} is the region's {free[0].name}: the only one of its kind")
    return True


def _new_slot(interface: Interface, module: ModuleInfo, result: Slots) -> None:
    taken = {slot.name for slot in result.slots}
    name = unique(identifier(interface.name), taken)
    result.slots.append(Slot(name, interface.protocol, interface.mode, {module.name: interface}))


def unique(name: str, taken: Iterable[str]) -> str:
    """Return the name, with a number appended if it is taken."""
    taken = set(taken)
    number = 2
    result = name
    while result in taken:
        result = f"{name}_{number}"
        number += 1
    return result


def _add(lists: dict[str, list[str]], key: str, text: str) -> None:
    lists.setdefault(key, []).append(text)

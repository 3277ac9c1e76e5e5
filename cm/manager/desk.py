# SPDX-License-Identifier: Apache-2.0
"""Registers by name for requests: what is visible now, who may write, and no access to what is being changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from cm.manager import resolve
from cm.manager.errors import NothingLoaded, RegionBusy
from cm.manager.leases import Leases
from cm.manager.registers import RegisterAccess, checked_write, find, split_name, value_of
from cm.manager.state import BoardState, RegionPhase
from cm.messages.requests import RegWrite
from cm.messages.status import RegValue, RegValues
from cm.schema.model import Access, BitField, Config, Register


class Holder(Protocol):
    """Who has the state."""

    @property
    def state(self) -> BoardState:
        """What the board holds."""

    @property
    def configs(self) -> Mapping[str, Config]:
        """All configurations."""

    def loaded_config(self) -> Config | None:
        """The one that is loaded."""

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state in one piece."""


Found = list[tuple[Register, BitField | None]]
_KEPT = 256  # requests whose names are kept


@dataclass(frozen=True, slots=True)
class Locked:
    """What a running change has taken away: regions, or the whole device."""

    regions: frozenset[str] = frozenset()
    whole: bool = False

    def __contains__(self, region: object) -> bool:
        return self.whole or region in self.regions


class RegisterDesk:
    """Reads and writes for requests. `lock` is held over each access, so that a change waits for its end."""

    def __init__(
        self, holder: Holder, access: RegisterAccess, leases: Leases, lock: AbstractContextManager[object]
    ) -> None:
        self._holder = holder
        self._access = access
        self._leases = leases
        self._lock = lock
        self._locked = Locked()
        self._seen: tuple[Config | None, str | None, Mapping[str, Register]] = (None, None, {})
        self._found: dict[tuple[str, ...], Found] = {}  # among those seen, by the names of a request

    def keep_off(self, locked: Locked) -> None:
        """Refuse what is locked from here on; waits for an access under way."""
        with self._lock:
            self._locked = locked

    def read(self, names: tuple[str, ...]) -> RegValues:
        """Values by name; of all that can be read if none is given."""
        visible = self._visible()
        chosen = (self._found.get(names) or self._find_all(visible, names)) if names else self._readable(visible)
        with self._lock:
            return self._values(tuple([self._read(register, field) for register, field in chosen]))

    def write(self, writes: tuple[RegWrite, ...], lease: str) -> RegValues:
        """Check all, then write in order; what the registers then hold."""
        visible = self._visible()
        checked = [checked_write(visible, w, lambda n=w.name: self._elsewhere(n, visible)) for w in writes]  # type: ignore[misc]
        self._check_leases([r for r, _, _ in checked], lease)
        with self._lock:
            for register, _, _ in checked:
                self._check_free(register)
            return self._values(tuple(self._write(register, value, mask) for register, value, mask in checked))

    def _values(self, values: tuple[RegValue, ...]) -> RegValues:
        state = self._holder.state
        return RegValues(values, state.config or "", state.mode or "")

    def _visible(self) -> Mapping[str, Register]:
        config = self._holder.loaded_config()
        if config is None:
            there = resolve.listed(self._holder.configs)
            raise NothingLoaded(f"nothing is loaded, so there are no registers; there are {there}")
        mode = self._holder.state.mode
        known, known_mode, registers = self._seen
        if known is not config or known_mode != mode:
            registers = config.visible_registers(mode)
            self._seen = (config, mode, registers)
            self._found.clear()
        return registers

    def _find_all(self, visible: Mapping[str, Register], names: tuple[str, ...]) -> Found:
        """Look names up, and keep what was found: who asks for registers asks again."""
        found = [self._find(visible, name) for name in names]
        if len(self._found) < _KEPT:
            self._found[names] = found
        return found

    def _find(self, visible: Mapping[str, Register], name: str) -> tuple[Register, BitField | None]:
        return find(visible, name, lambda: self._elsewhere(name, visible))

    def _elsewhere(self, name: str, visible: Mapping[str, Register]) -> str:
        """Says in which modes a register can be named, when it cannot be in this one."""
        register, config = split_name(name)[0], self._holder.loaded_config()
        if config is None or register in visible:
            return ""
        modes = [m for m in config.modes if register in config.visible_registers(m)]
        return f" ({self._holder.state.mode}); modes {', '.join(modes)} have it" if modes else ""

    def _readable(self, visible: Mapping[str, Register]) -> Found:
        return [(r, None) for r in visible.values() if r.access is not Access.WO and self._is_free(r)]

    def _read(self, register: Register, field: BitField | None) -> RegValue:
        self._check_free(register)
        value = self._access.read(register)
        if field is None:
            return value_of(register, value)
        return RegValue(f"{register.name}.{field.name}", (value & field.mask) >> field.lsb)

    def _write(self, register: Register, value: int, mask: int) -> RegValue:
        written = self._access.write(register, value, mask, self._holder.state.values.get(register.name))
        self._holder.update(lambda state: state.with_value(register.name, written))
        shown = written if register.access is not Access.RW else self._access.read(register)
        return value_of(register, shown)

    def _is_free(self, register: Register) -> bool:
        if register.region is None:
            return not self._locked.whole
        ready = self._holder.state.region(register.region).phase is RegionPhase.READY
        return ready and register.region not in self._locked

    def _check_free(self, register: Register) -> None:
        if self._is_free(register):
            return
        where = f"region {register.region}" if register.region else "the static part"
        locked = self._locked.whole or register.region in self._locked
        how = "being reconfigured" if locked else self._holder.state.region(register.region or "").phase.value
        raise RegionBusy(f"register {register.name!r} lies in {where}, which is {how}")

    def _check_leases(self, registers: list[Register], lease: str) -> None:
        scopes = {f"registers:{r.name}" for r in registers} | {f"region:{r.region}" for r in registers if r.region}
        self._leases.check(tuple(scopes), lease)

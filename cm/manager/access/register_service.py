# SPDX-License-Identifier: Apache-2.0
"""Registers by name for requests: what is visible now, who may write, and no access to what is being changed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from cm.errors import CmError
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_names import checked_write, find, split_name
from cm.manager.errors import AccessDenied, NothingLoaded, RegionBusy
from cm.manager.planning import goals
from cm.manager.state.board_state import LockedRegions, ManagerState
from cm.manager.state.table import BoardState, RegionPhase
from cm.messages.requests import RegWrite
from cm.messages.status import RegValue, RegValues
from cm.schema.model import Access, BitField, Config, Register

Checked = tuple[Register, int, int]  # value and mask in its place
_WO, _RW, _READY = Access.WO, Access.RW, RegionPhase.READY  # a look into an enum's class is not free


class _Place(NamedTuple):
    """Where a name leads."""

    register: Register
    field: BitField | None
    region: str | None
    address: int
    width: int


class _View:
    """What can be named in the mode that the board is in, what was named in it before, and what is free.

    It is made anew where the board holds something else, not with each value that is written.
    """

    __slots__ = ("board", "config", "configs", "free", "locked", "mode", "places", "registers")

    def __init__(self, state: ManagerState, config: Config) -> None:
        self.configs, self.config, self.board, self.locked = state.configs, config, state.latest, state.locked
        self.mode = self.board.mode
        self.registers: Mapping[str, Register] = config.visible_registers(self.mode)
        self.places: dict[str, _Place] = {}
        regions = {register.region for register in self.registers.values()}  # and None for the static part
        self.free = {region for region in regions if _is_free(self.board, self.locked, region)}

    def still_holds(self, state: ManagerState) -> bool:
        """Whether it is true of what the board holds now."""
        then, now = self.board, state.latest
        return (
            (then is now or (then.regions is now.regions and then.mode == now.mode and then.config == now.config))
            and self.configs is state.configs
            and self.locked is state.locked
        )


def _is_free(board: BoardState, locked: LockedRegions, region: str | None) -> bool:
    if region is None:
        return not locked.whole
    return board.region(region).phase is _READY and region not in locked


class Prepared:
    """Registers that are read again and again: what their names led to, for as long as the mode stays.

    `names` and `fields` say what belongs to the values: fields (name, lowest bit, mask) are to be taken out of them.
    """

    __slots__ = ("_places", "_regions", "_service", "_view", "config_name", "fields", "mode", "names")

    def __init__(self, service: RegisterService, view: _View, places: Sequence[_Place]) -> None:
        self._service, self._view = service, view
        self._places = [(p.address, p.width, *((p.field.lsb, p.field.mask) if p.field else (0, -1))) for p in places]
        self._regions = {p.region for p in places}
        self.config_name, self.mode = view.config.name, view.mode or ""
        self.names = tuple([p.register.name + (f".{p.field.name}" if p.field else "") for p in places])
        self.fields = tuple([() if p.field else _fields(p.register) for p in places])

    def values(self) -> list[int] | None:
        """The values in the order of the names; None where they are no longer what they were, or cannot be read now."""
        return self._service.read_again(self._view, self._regions, self._places)


def _fields(register: Register) -> tuple[tuple[str, int, int], ...]:
    return tuple([(f.name, f.lsb, f.mask) for f in register.fields.values()])


def _flags(config: Config, status: str) -> int:
    """The bits of a status register that a written 1 clears."""
    bits = [i.bit for i in config.interrupts.values() if i.status == status and i.acknowledge and i.bit is not None]
    return sum({1 << bit for bit in bits})


def value_of(register: Register, value: int) -> RegValue:
    """A value with its fields taken apart."""
    if not register.fields:
        return RegValue(register.name, value)
    return RegValue(
        register.name, value, tuple([(f.name, (value & f.mask) >> f.lsb) for f in register.fields.values()])
    )


class RegisterService:
    """Reads and writes for requests. The state's lock is held over each access, so that a change waits for its end."""

    def __init__(self, state: ManagerState, bus: RegisterBus, leases: Leases) -> None:
        self._state = state
        self._bus = bus
        self._leases = leases
        self._lock = state.lock
        self._view: _View | None = None

    def read(self, names: tuple[str, ...]) -> RegValues:
        """Values by name; of all that can be read if none is given."""
        with self._lock:
            view = self._look()
            known = view.places
            places = [known.get(n) or self._find(view, n) for n in names] if names else self._readable(view)
            return RegValues(tuple([self._read(p, view) for p in places]), view.config.name, view.mode or "")

    def prepare(self, names: tuple[str, ...]) -> Prepared | None:
        """What `read` of these names will do again; None where it refuses, or where it reads all that there is."""
        with self._lock:
            try:
                view = self._look()
                places = [self._find(view, name) for name in names]
            except CmError:
                return None
        readable = places and all(p.register.access is not _WO for p in places)
        return Prepared(self, view, places) if readable else None

    def read_again(
        self, view: _View, regions: set[str | None], places: list[tuple[int, int, int, int]]
    ) -> list[int] | None:
        """For `Prepared`."""
        with self._lock:
            if self._look() is not view or not regions <= view.free:
                return None
            read = self._bus.read_address
            return [(read(address, width) & mask) >> lsb for address, width, lsb, mask in places]

    def visible_names(self) -> Collection[str]:
        """Those of all registers of this mode; none where nothing is loaded."""
        try:
            return self._look().registers.keys()
        except NothingLoaded:
            return ()

    def readable_names(self) -> tuple[str, ...]:
        """Those of all registers that can be read now."""
        with self._lock:
            return tuple([place.register.name for place in self._readable(self._look())])

    def write(self, writes: tuple[RegWrite, ...], lease: str) -> RegValues:
        """Check all, then write in order; what the registers then hold."""
        return self.write_checked(self.checked(writes, lease))

    def checked(self, writes: tuple[RegWrite, ...], lease: str) -> list[Checked]:
        """Registers, values and masks of writes that may be done. Raises for the first that may not."""
        visible = self._look().registers
        checked = [checked_write(visible, w, lambda n=w.name: self._elsewhere(n, visible)) for w in writes]  # type: ignore[misc]
        self._check_leases([r for r, _, _ in checked], lease)
        return checked

    def write_checked(self, checked: list[Checked]) -> RegValues:
        """Write in order what was checked. Raises RegionBusy where a change has begun."""
        with self._lock:
            view = self._look()
            for register, _, _ in checked:
                self._check_free(register)
            values = tuple([self._write(register, value, mask) for register, value, mask in checked])
            return RegValues(values, view.config.name, view.mode or "", self._state.written())

    def check_again(self, checked: list[Checked], lease: str) -> None:
        """Raise HeldBy, RegionBusy where what was checked a while ago has another holder, or is not there any more."""
        registers, visible = [register for register, _, _ in checked], self._look().registers
        for register in registers:
            if visible.get(register.name) is not register:
                raise RegionBusy(f"register {register.name!r}: the mode was changed while the request was carried out")
        self._check_leases(registers, lease)

    def take_flags(self, name: str, clear: int) -> int:
        """Read a status register and acknowledge those interrupts of `clear` (bits) that stand; what was read.

        Leases keep clients off what others set. A flag is the hardware's: the daemon clears it while a client holds
        the register; nor is it a value to be published or recorded. But what a change has taken away is not
        touched, and a region that is not ready would not answer. Raises RegionBusy, UnknownRegister,
        NothingLoaded, DeviceError.
        """
        with self._lock:
            view = self._look()
            register = (view.places.get(name) or self._find(view, name)).register
            self._check_free(register)
            return self._bus.take_flags(register, clear, _flags(view.config, name))

    def _look(self) -> _View:
        view = self._view
        if view is None or not view.still_holds(self._state):
            view = self._view = self._renewed(view)
        return view

    def _renewed(self, before: _View | None) -> _View:
        config = self._state.loaded_config()
        if config is None:
            there = goals.listed(self._state.configs)
            raise NothingLoaded(f"nothing is loaded, so there are no registers; there are {there}")
        view = _View(self._state, config)
        if before is not None and before.config is config and before.mode == view.mode:
            view.places = before.places
        return view

    def _find(self, view: _View, name: str) -> _Place:
        register, field = find(view.registers, name, lambda: self._elsewhere(name, view.registers))
        place = view.places[name] = _Place(register, field, register.region, register.address, register.width)
        return place

    def _elsewhere(self, name: str, visible: Mapping[str, Register]) -> str:
        """Says in which modes a register can be named, when it cannot be in this one."""
        register, config = split_name(name)[0], self._state.loaded_config()
        if config is None or register in visible:
            return ""
        modes = [m for m in config.modes if register in config.visible_registers(m)]
        return f" ({self._state.latest.mode}); modes {', '.join(modes)} have it" if modes else ""

    def _readable(self, view: _View) -> list[_Place]:
        readable = (r for r in view.registers.values() if r.access is not _WO and r.region in view.free)
        return [view.places.get(r.name) or self._find(view, r.name) for r in readable]

    def _read(self, place: _Place, view: _View) -> RegValue:
        register, field, region, address, width = place
        if region not in view.free:
            self._check_free(register)
        if register.access is _WO:
            raise AccessDenied(f"register {register.name!r} is write-only")
        value = self._bus.read_address(address, width)
        if field is None:
            return value_of(register, value) if register.fields else RegValue(register.name, value)
        return RegValue(f"{register.name}.{field.name}", (value & field.mask) >> field.lsb)

    def _write(self, register: Register, value: int, mask: int) -> RegValue:
        written = self._bus.write(register, value, mask, self._state.written_value(register.name))
        self._state.note_written(register.name, written)
        shown = written if register.access is not _RW else self._bus.read(register)
        return value_of(register, shown)

    def check_region(self, region: str | None, what: str) -> None:
        """Raise RegionBusy while `region` (None: the static part) is being changed, or stands cut off."""
        if not _is_free(self._state.latest, self._state.locked, region):
            self._refuse(region, what)

    def _check_free(self, register: Register) -> None:
        self.check_region(register.region, f"register {register.name!r}")

    def _refuse(self, region: str | None, what: str) -> None:
        where = f"region {region}" if region else "the static part"
        locked = region in self._state.locked
        how = "being reconfigured" if locked else self._state.latest.region(region or "").phase.value
        raise RegionBusy(f"{what} lies in {where}, which is {how}")

    def _check_leases(self, registers: list[Register], lease: str) -> None:
        scopes = {f"registers:{r.name}" for r in registers} | {f"region:{r.region}" for r in registers if r.region}
        self._leases.check(tuple(scopes), lease)

# SPDX-License-Identifier: Apache-2.0
"""Registers by name, for requests: read and written at once, or in pieces where a request names many."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from time import monotonic_ns
from typing import TYPE_CHECKING

from cm.errors import CmError
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_view import (
    Checked,
    Place,
    View,
    checked_write,
    find,
    is_free,
    missing,
    place_of,
    split_name,
)
from cm.manager.errors import AccessDenied, NothingLoaded, RegionBusy, listed
from cm.manager.state.journal import ManagerState
from cm.schema.model import Access, FieldAccess, Register
from cm.wire.messages.requests import RegWrite
from cm.wire.messages.status import RegValue, RegValues

if TYPE_CHECKING:
    from cm.manager.interfaces import RegisterTable

AT_ONCE = 32  # most registers of a request that is served in one go
_SOME = 16  # in a piece of a longer one, at most
_LONG = 200_000  # nanoseconds of a piece; if it takes longer, the next one has fewer


class _Some:
    """How many registers a piece has: fewer if an access takes long, as on a slow bus or a simulated board."""

    def __init__(self) -> None:
        self.count = _SOME
        self._began = 0

    def __enter__(self) -> None:
        self._began = monotonic_ns()

    def __exit__(self, *_: object) -> None:
        took = monotonic_ns() - self._began
        if took > _LONG:
            self.count = max(1, self.count // 2)
        elif took < _LONG // 4:
            self.count = min(_SOME, self.count * 2)


class _Pieces:
    """The progress of a request, of which `step` does one piece."""

    def __init__(self, service: RegisterService) -> None:
        self._service = service
        self._values: list[RegValue] = []
        self._at = 0
        self._some = _Some()
        self._last = RegValues(())
        self.newest: tuple[RegValue, ...] = ()  # of the last piece

    @property
    def result(self) -> RegValues:
        """What has been read or written so far."""
        return self._last._replace(values=tuple(self._values))


class ReadPieces(_Pieces):
    """A read; without names, of all readable registers: those that have gone meanwhile are then left out."""

    def __init__(self, service: RegisterService, names: tuple[str, ...]) -> None:
        super().__init__(service)
        self._strict = bool(names)
        self._names = names or service.readable_names()

    def step(self) -> bool:
        """Read the next registers; returns whether they were the last. Raises as `RegisterService.read`."""
        some = self._names[self._at : self._at + self._some.count]
        self._at += len(some)
        before = len(self._values)
        with self._some:
            for names in (some,) if self._strict else ((name,) for name in some):
                with suppress(*(() if self._strict else (CmError,))):
                    self._last = self._service.read(names)
                    self._values += self._last.values
        self.newest = tuple(self._values[before:])
        return self._at >= len(self._names)


class WritePieces(_Pieces):
    """A write, all of which is checked before it begins; each piece is checked again, in case something has changed."""

    def __init__(self, service: RegisterService, writes: tuple[RegWrite, ...], lease: str) -> None:
        super().__init__(service)
        self._lease = lease
        self._checked = service.checked(writes, lease)

    def step(self) -> bool:
        """Write the next registers; returns whether they were the last. Raises as `RegisterService.write`."""
        some = self._checked[self._at : self._at + self._some.count]
        self.newest = ()
        with self._some:
            self._service.check_again(some, self._lease)
            self._last = self._service.write_checked(some)
        self._at += len(some)
        self.newest = self._last.values
        self._values += self.newest
        return self._at >= len(self._checked)


_WO, _FIELD_WO = Access.WO, FieldAccess.WO  # looking them up in the enum's class takes time


def value_of(register: Register, value: int) -> RegValue:
    """A register's value, and the values of its fields."""
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
        self._view: View | None = None

    def read(self, names: tuple[str, ...]) -> RegValues:
        """Values by name; of all that can be read if none is given."""
        with self._lock:
            view, state = self._view, self._state
            same = view is not None and view.board is state.latest and view.locked is state.locked  # mostly
            if view is None or not same or view.configs is not state.configs:
                view = self._current_view()
            known = view.places
            places = [known.get(n) or self._find(view, n) for n in names] if names else self._readable(view)
            for place in places:
                if place.region not in view.free or place.register.access is _WO or place.field is not None:
                    self._check_readable(place)
            found = self._bus.read_places(places)
            values = [
                RegValue(
                    place.register.name, value, tuple([(n, (value & mask) >> lsb) for n, mask, lsb in place.parts])
                )
                if (field := place.field) is None
                else RegValue(f"{place.register.name}.{field.name}", (value & place.mask) >> place.lsb)
                for place, value in zip(places, found, strict=True)
            ]
            return RegValues(tuple(values), view.config.name, view.mode or "")

    def visible_names(self) -> Collection[str]:
        """The names of all registers of this mode; none if nothing is loaded."""
        try:
            return self._current_view().registers.keys()
        except NothingLoaded:
            return ()

    def readable_names(self) -> tuple[str, ...]:
        """The names of all registers that can be read now."""
        with self._lock:
            return tuple([place.register.name for place in self._readable(self._current_view())])

    def offer(self, registers: Iterable[str], table: RegisterTable) -> None:
        """Let clients on this machine read registers and their fields by themselves, those that `read` would read now.

        Left out are those that reading changes: who wants that asks for it. Raises NothingLoaded, DeviceTimeout.
        """
        with self._lock:  # a change that begins meanwhile waits, and withdraws them
            view = self._current_view()
            for register in filter(None, map(view.registers.get, registers)):
                if register.region not in view.free or register.access is _WO or register.read_changes:
                    continue
                fields = [field for field in register.fields.values() if field.access is not _FIELD_WO]
                for field in (None, *fields):
                    name = register.name if field is None else f"{register.name}.{field.name}"
                    try:
                        self._bus.offer(name, place_of(register, field), table)
                    except TimeoutError:  # a read hangs
                        raise
                    except CmError:  # whoever asks for it is told why
                        break

    def write(self, writes: tuple[RegWrite, ...], lease: str) -> RegValues:
        """Check all, then write in order; returns what the registers then hold."""
        with self._lock:
            view = self._current_view()
            return self._do(view, self._check(view, writes, lease))

    def checked(self, writes: tuple[RegWrite, ...], lease: str) -> list[Checked]:
        """Registers, values and masks of writes, if all are allowed. Raises for the first that is not."""
        with self._lock:
            return self._check(self._current_view(), writes, lease)

    def write_checked(self, checked: list[Checked]) -> RegValues:
        """Write in order what was checked. Raises RegionBusy if a change has begun."""
        with self._lock:
            return self._do(self._current_view(), checked)

    def check_again(self, checked: list[Checked], lease: str) -> None:
        """Raise HeldBy, RegionBusy or RecordFailed if what was checked a while ago would be refused now."""
        visible = self._current_view().registers
        for register in (place.register for place, _, _ in checked):
            if visible.get(register.name) is not register:
                raise RegionBusy(f"register {register.name!r}: the mode was changed while the request was carried out")
        if self._leases.any_held or self._state.overtaken:
            self._check_leases(checked, lease)

    def _check(self, view: View, writes: tuple[RegWrite, ...], lease: str) -> list[Checked]:
        known = view.places
        checked: list[Checked] = []
        for write in writes:
            place = known.get(write.name) or self._find(view, write.name)
            checked.append(checked_write(place, write))
            if place.rest.unread or write.mask is not None:
                self._check_known(checked)
        if self._leases.any_held or self._state.overtaken:
            self._check_leases(checked, lease)
        return checked

    def _do(self, view: View, checked: list[Checked]) -> RegValues:
        for place, _, _ in checked:
            if place.region not in view.free:
                self._check_free(place.register)
        if len(checked) == 1:  # mostly; a comprehension is a call
            values: tuple[RegValue, ...] = (self._write(*checked[0]),)
        else:
            values = tuple([self._write(place, value, mask) for place, value, mask in checked])
        return RegValues(values, view.config.name, view.mode or "", self._state.written())

    def unread(self, names: Iterable[str]) -> list[str]:
        """Those of some registers that can only be written."""
        known = self._current_view().registers
        return [name for name in names if name in known and known[name].access is _WO]

    def take_flags(self, name: str, clear: int) -> int:
        """Read a status register, and acknowledge those interrupts of `clear` (bits) that are set; returns the value.

        Leases keep clients off values that others set. A flag is set by the hardware: the daemon clears it even if a
        client holds the register, and it is not a value to be published or recorded. But registers that a change has
        locked are not touched, and a region that is not ready would not answer. Raises RegionBusy, UnknownRegister,
        NothingLoaded, DeviceError.
        """
        with self._lock:
            view = self._current_view()
            register = (view.places.get(name) or self._find(view, name)).register
            self._check_free(register)
            known = [i for i in view.config.interrupts.values() if i.status == name and i.acknowledge]
            cleared_by_1 = sum({1 << i.bit for i in known if i.bit is not None})
            return self._bus.take_flags(register, clear, cleared_by_1)

    def _current_view(self) -> View:
        view, state = self._view, self._state
        if view is None:
            return self._renewed(None)
        same = view.board is state.latest and view.locked is state.locked and view.configs is state.configs  # mostly
        return view if same or view.still_holds(state) else self._renewed(view)

    def _renewed(self, before: View | None) -> View:
        config = self._state.loaded_config()
        if config is None:
            there = "; ".join(filter(None, (f"there are {listed(self._state.configs)}", self._state.taken)))
            raise NothingLoaded(f"nothing is loaded, so there are no registers; {there}")
        view = View(self._state, config)
        if before is not None and before.config is config and before.mode == view.mode:
            view.places = before.places
        self._view = view
        return view

    def _find(self, view: View, name: str) -> Place:
        register, field = find(view.registers, name, lambda: self._elsewhere(name, view.registers))
        place = view.places[name] = place_of(register, field)
        return place

    def _elsewhere(self, name: str, visible: Mapping[str, Register]) -> str:
        """Says in which modes a register can be named, if not in this one."""
        register, config = split_name(name)[0], self._state.loaded_config()
        if config is None or register in visible:
            return ""
        modes = [m for m in config.modes if register in config.visible_registers(m)]
        return f" ({self._state.latest.mode}); modes {', '.join(modes)} have it" if modes else ""

    def _readable(self, view: View) -> list[Place]:
        readable = (r for r in view.registers.values() if r.access is not _WO and r.region in view.free)
        places = [view.places.get(r.name) or self._find(view, r.name) for r in readable]
        return [place for place in places if not place.read_changes]  # who wants that names it

    def _check_readable(self, place: Place) -> None:
        register, field = place.register, place.field
        self._check_free(register)
        if register.access is _WO:
            raise AccessDenied(f"register {register.name!r} is write-only")
        if field is not None and field.access is _FIELD_WO:
            raise AccessDenied(f"field {register.name}.{field.name} is write-only")

    def _write(self, place: Place, value: int, mask: int) -> RegValue:
        register, bus = place.register, self._bus
        if mask == place.mask and place.field is None:
            bus.write_address(place.address, place.width, value)
        else:
            rest = place.rest if mask == place.mask else register.rest(mask)
            value = bus.write(register, value, mask, self._last(register), rest)
        self._state.note_written(register.name, value, register.access is _WO)
        shown = value if not place.shown else bus.read_address(place.address, place.width)
        return RegValue(register.name, shown, tuple([(n, (shown & m) >> lsb) for n, m, lsb in place.parts]))

    def _last(self, register: Register) -> int | None:
        """What a register holds that is not read, as far as is known."""
        last = self._state.written_value(register.name)
        return register.reset if last is None else last

    def check_region(self, region: str | None, what: str) -> None:
        """Raise RegionBusy while `region` (None: the static part) is being changed, or is isolated."""
        if not is_free(self._state.latest, self._state.locked, region):
            where = f"region {region}" if region else "the static part"
            locked = region in self._state.locked
            how = "being reconfigured" if locked else self._state.latest.region(region or "").phase.value
            raise RegionBusy(f"{what} lies in {where}, which is {how}")

    def _check_free(self, register: Register) -> None:
        self.check_region(register.region, f"register {register.name!r}")

    def _check_known(self, checked: list[Checked]) -> None:
        """Refuse the last write, if it would need to know what was never written; one before it may write that."""
        place, _, mask = checked[-1]
        register = place.register
        if mask == (1 << register.width) - 1 or not register.rest(mask).unread or self._last(register) is not None:
            return
        full = (1 << register.width) - 1
        if not any(p.register is register and p.field is None and m == full for p, _, m in checked):
            raise missing(place, mask)

    def _check_leases(self, checked: list[Checked], lease: str) -> None:
        if self._state.overtaken:
            self._state.check_kept()
        registers = [place.register for place, _, _ in checked]
        scopes = {f"registers:{r.name}" for r in registers} | {f"region:{r.region}" for r in registers if r.region}
        self._leases.check(tuple(scopes), lease)

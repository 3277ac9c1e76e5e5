# SPDX-License-Identifier: Apache-2.0
"""What can be named in the mode that the board is in: where a name leads, and what may be done there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from cm.errors import InvalidRequest
from cm.field_access import Rest, changed_too, must_not_be_read
from cm.manager.errors import AccessDenied, OutOfRange, UnknownRegister, hint
from cm.manager.state.board_state import BoardState, RegionPhase
from cm.manager.state.journal import LockedRegions, ManagerState
from cm.schema.model import Access, BitField, Config, Register
from cm.wire.messages.requests import RegWrite

_RO, _READY = Access.RO, RegionPhase.READY  # looking them up in the enum's class takes time


def split_name(name: str) -> tuple[str, str | None]:
    """``"control.enable"`` → register, field."""
    register, dot, field = name.partition(".")
    return register, field if dot else None


def find(
    registers: Mapping[str, Register], name: str, elsewhere: Callable[[], str]
) -> tuple[Register, BitField | None]:
    """The register, and the field if one is named.

    Raises UnknownRegister with the nearest names, or with what `elsewhere` says of other modes.
    """
    register_name, field_name = split_name(name)
    register = registers.get(register_name)
    if register is None:
        raise UnknownRegister(
            f"no register {register_name!r} in this mode{elsewhere() or hint(register_name, registers)}"
        )
    if field_name is None:
        return register, None
    field = register.fields.get(field_name)
    if field is None:
        raise UnknownRegister(
            f"register {register_name!r} has no field {field_name!r}{hint(field_name, register.fields)}"
        )
    return register, field


def in_range(name: str, value: int, low: int, high: int) -> None:
    """Raise OutOfRange for a value that a register does not allow."""
    if not low <= value <= high:
        raise OutOfRange(f"register {name!r}: {value} ({value:#x}) is outside {low} to {high} ({low:#x} to {high:#x})")


class Place(NamedTuple):
    """Where a name leads: a register, or one of its fields.

    Values from `low` to `high` may be written, to the bits of `mask`, from `lsb` up; none if `low` is above `high`.
    """

    register: Register
    field: BitField | None
    region: str | None
    address: int
    width: int
    low: int
    high: int
    lsb: int
    mask: int
    rest: Rest  # what is written to the other bits
    read_changes: bool  # reading the register changes a field of it
    shown: bool  # after a write, it is read
    parts: tuple[tuple[str, int, int], ...]  # name, mask and lowest bit of each of the register's fields


Checked = tuple[Place, int, int]  # value and mask in the register's place


def place_of(register: Register, field: BitField | None) -> Place:
    """The place that a name leads to."""
    bits = field.width if field is not None else register.width
    low, high, lsb, mask = 0, (1 << bits) - 1, 0, (1 << bits) - 1
    if field is not None:
        lsb, mask = field.lsb, field.mask
    else:
        low = max(low, register.minimum or 0)
        high = high if register.maximum is None else min(high, register.maximum)
    rest, changes = register.rest(mask), register.read_changes
    if not _is_writable(register, field) or rest.changed:
        low, high = 1, 0
    shown = register.access is Access.RW and not changes
    where = (register.region, register.address, register.width)
    parts = tuple([(f.name, f.mask, f.lsb) for f in register.fields.values()])
    return Place(register, field, *where, low, high, lsb, mask, rest, changes, shown, parts)


def _is_writable(register: Register, field: BitField | None) -> bool:
    return register.access is not _RO and (field is None or register.access_of(field).kind.writable)


def checked_write(place: Place, write: RegWrite) -> Checked:
    """A write that is allowed. Raises AccessDenied, OutOfRange or InvalidRequest; nothing was touched."""
    if write.mask is None and not write.named and place.low <= write.value <= place.high:
        return place, write.value << place.lsb, place.mask  # the usual case
    register, field = place.register, place.field
    if register.access is _RO:
        raise AccessDenied(f"register {register.name!r} is read-only")
    if write.named:
        write = _by_name(write, field)
    if not _is_writable(register, field):
        raise AccessDenied(f"field {write.name!r} is read-only")
    if field is not None and write.mask is not None:
        raise InvalidRequest(f"{write.name!r} is a field: give a value or a mask, not both")
    mask = place.mask if write.mask is None else write.mask
    rest = place.rest if mask == place.mask else register.rest(mask)
    if rest.changed:
        raise AccessDenied(changed_too(write.name, register.name, rest))
    if mask == place.mask:
        in_range(write.name, write.value, place.low, place.high)
        return place, write.value << place.lsb, mask
    in_range(write.name, write.value, 0, place.mask)
    if not 0 <= mask <= place.mask:
        raise OutOfRange(f"register {write.name!r}: mask {mask:#x} does not fit {register.width} bits")
    return place, write.value & mask, mask


def missing(place: Place, mask: int) -> AccessDenied:
    """The refusal of a write that would have to write other fields as they were last written, which is not known."""
    register = place.register
    rest = place.rest if mask == place.mask else register.rest(mask)
    why = must_not_be_read(register.access.value, [register.access_of(f).value for f in register.fields.values()])
    return AccessDenied(
        f"register {register.name!r} {why}, and what {rest.unread[0]} holds is not known: write the whole of it first, "
        "or say its reset in the schema"
    )


def _by_name(write: RegWrite, field: BitField | None) -> RegWrite:
    """A write that names a value, with the value in numbers. Raises OutOfRange."""
    names = field.values if field is not None else {}
    if not names:
        raise OutOfRange(f"register {write.name!r} takes an integer, not {write.named!r}: its values have no names")
    if write.named not in names:
        raise OutOfRange(f"register {write.name!r} has no value {write.named!r}{hint(write.named, names)}")
    return RegWrite(write.name, names[write.named], mask=write.mask)


class View:
    """What can be named in the mode that the board is in, the names looked up so far, and which regions are free.

    It is made anew when the board holds something else, not for each value that is written.
    """

    __slots__ = ("board", "config", "configs", "free", "locked", "mode", "places", "registers")

    def __init__(self, state: ManagerState, config: Config) -> None:
        self.configs, self.board, self.locked = state.configs, state.latest, state.locked
        self.config, self.mode = config, state.latest.mode
        self.registers: Mapping[str, Register] = config.visible_registers(self.mode)
        self.places: dict[str, Place] = {}
        regions = {register.region for register in self.registers.values()}  # with None for the static part
        self.free = {region for region in regions if is_free(state.latest, state.locked, region)}

    def still_holds(self, state: ManagerState) -> bool:
        """Whether it is still true of what the board holds now."""
        then, now = self.board, state.latest
        if then is not now:
            if then.regions is not now.regions or then.mode != now.mode or then.config != now.config:
                return False
            self.board = now  # only values differ
        return self.configs is state.configs and self.locked is state.locked


def is_free(board: BoardState, locked: LockedRegions, region: str | None) -> bool:
    """Whether registers of a region (None: of the static part) may be accessed."""
    if region is None:
        return not locked.whole
    return board.region(region).phase is _READY and region not in locked

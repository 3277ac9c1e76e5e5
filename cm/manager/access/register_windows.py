# SPDX-License-Identifier: Apache-2.0
"""Windows: pages of registers that clients have mapped, taken back before a change touches their region.

What a client does in them is not seen here. So they are lent only where the pages hold nothing but the registers of
one region, and what was written there is read again from the hardware when a loan ends.
"""

from __future__ import annotations

import errno
import mmap
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import count
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from cm.errors import Busy, CmError, InvalidRequest, NotFound
from cm.frozen import dataclass
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService, value_of
from cm.manager.access.register_view import is_free
from cm.manager.errors import HeldBy, ModuleAbsent, NothingLoaded, NoWindow, RegionBusy, hint
from cm.manager.state.journal import LockedRegions, ManagerState
from cm.manager.status_reports import memory_info, register_info
from cm.manager.touched import STATIC, window_place
from cm.schema.model import Access, Block, Config, Memory, Mode, Module, Register
from cm.wire.messages.status import ConfigInfo, RegValues, WindowStatus

if TYPE_CHECKING:
    from cm.manager.interfaces import Devices, TimeSource, WindowLender

_RELEASED, _CALL, _GONE = 0, 1, 4  # why one ended: as `cm.device.WindowEnd`
_READING = 0.0005  # seconds that reading again may hold up a change; what is left then is not known any more
_SURE = 8  # registers that are read even then: the time may have gone to other processes


class WindowRequest(NamedTuple):
    """What a client asks for: the registers of a module, of what a region holds, of a block or of the static part."""

    name: str
    write: bool = False
    exclusive: bool = False
    lease: str = ""  # ids of its own, between commas
    client: str = ""
    pid: int = 0


class Place(NamedTuple):
    """Where a name leads now: whose registers they are, and the whole pages that hold them."""

    region: str | None
    module: str
    config: Config
    mode: str
    registers: tuple[Register, ...]
    memories: tuple[Memory, ...]
    address: int
    length: int


@dataclass(frozen=True, slots=True, eq=False)
class Loan:
    """Pages that were lent; `ended` is told why they are not any more, and of the mode that the board goes to."""

    number: int
    id: int  # of the node's grant
    place: Place
    request: WindowRequest
    lease: str  # of an exclusive one
    held: dict[str, int]  # what the registers held when it began
    ended: Callable[[int, str, str], None]

    @property
    def info(self) -> ConfigInfo:
        """The registers and memories in it, for the client."""
        config, mode = self.place.config, self.place.mode
        registers = tuple([register_info(r) for r in self.place.registers])
        memories = tuple([memory_info(m) for m in self.place.memories])
        return ConfigInfo(config.name, config.type.value, mode, registers=registers, memories=memories)

    @property
    def status(self) -> WindowStatus:
        """As all clients may see it."""
        place, asked = self.place, self.request
        whose = place.region or STATIC, place.module, place.address, place.length
        return WindowStatus(self.number, *whose, asked.write, asked.exclusive, asked.client, asked.pid)


class Windows:
    """All that are lent. Requests come from the loop's thread, `revoke` from that of changes."""

    def __init__(
        self, state: ManagerState, registers: RegisterService, bus: RegisterBus, leases: Leases, time: TimeSource
    ) -> None:
        self._state = state
        self._registers = registers
        self._bus = bus
        self._leases = leases
        self._time = time
        self._lock = threading.Lock()  # of the two below
        self._lender: WindowLender | None = None
        self._loans: dict[int, Loan] = {}
        self._numbers = count(1)
        self.changed: Callable[[], None] = lambda: None  # one was lent, or has ended
        self.closing: Callable[[], None] = lambda: None  # `fileno` is about to be closed

    def statuses(self) -> tuple[WindowStatus, ...]:
        """Who has which, oldest first."""
        with self._lock:
            return tuple([loan.status for loan in self._loans.values()])

    # ---- lending ------------------------------------------------------------------

    def lend(
        self, request: WindowRequest, devices: Devices, ended: Callable[[int, str, str], None]
    ) -> tuple[Loan, int]:
        """Lend; returns the loan, and a descriptor of the pages, the caller's to give away and to close.

        `ended` may be called from any thread, once, and not after `give_back`. Raises NothingLoaded, NotFound,
        ModuleAbsent, RegionBusy, HeldBy, NoWindow, Busy, RecordFailed.
        """
        with self._state.lock:  # a change that begins meanwhile waits, and takes it back
            place = self._find(request.name)
            self._check(place, request)
            loan, fd = self._lent(place, request, devices, ended)
        self.changed()
        return loan, fd

    def _lent(
        self, place: Place, request: WindowRequest, devices: Devices, ended: Callable[[int, str, str], None]
    ) -> tuple[Loan, int]:
        number = next(self._numbers)
        lease = ""
        if request.exclusive:
            lease = self._leases.hold(f"region:{place.region}", f"window {number}", request.client, request.pid)
        try:
            held = {r.name: self._bus.read(r) for r in place.registers if r.keeps} if request.write else {}
            identity, fd = self._granted(place, request.write, devices)
        except BaseException:
            self._leases.drop(lease)
            raise
        loan = Loan(number, identity, place, request, lease, held, ended)
        with self._lock:
            self._loans[number] = loan
        return loan, fd

    def _granted(self, place: Place, write: bool, devices: Devices) -> tuple[int, int]:
        if self._lender is None:
            self._lender = devices.windows()
        try:
            grant = self._lender.grant(place.address, place.length, write)
        except OSError as error:
            _refuse(place, error)
        return grant.id, grant.fd

    def _check(self, place: Place, request: WindowRequest) -> None:
        self._registers.check_region(place.region, f"window {request.name!r}")
        _check_pages(place)
        if request.exclusive and (not request.write or place.region is None):
            raise InvalidRequest("an exclusive window is one for writing, of a region: it goes with a lease on that")
        if not request.write:
            return
        self._leases.check(_scopes(place), request.lease)
        self._state.check_kept()
        with self._lock:
            loans = tuple(self._loans.values())
        others = [x for x in loans if request.exclusive and x.request.write and x.place.region == place.region]
        if others:
            raise HeldBy(f"region {place.region} has a window for writing already, of {others[0].request.client}")

    def _find(self, name: str) -> Place:
        config = self._state.loaded_config()
        if config is None:
            raise NothingLoaded(f"nothing is loaded, so there is no window {name!r}")
        region, module = self._where(config, name)
        mode = self._state.latest.mode or ""
        views: list[Config | Module] = [config, *([config.modules[module]] if module in config.modules else [])]
        registers = {r.name: r for view in views for r in view.registers.values()}
        memories = {m.name: m for view in views for m in view.memories.values()}
        if mode:
            registers.update(config.modes[mode].registers)
            memories.update(config.modes[mode].memories)
        ours = tuple([r for r in registers.values() if r.region == region])
        ends = [(r.address, r.address + r.width // 8) for r in ours]
        if region is None and name in config.blocks:
            ours, ends = _of_block(config.blocks[name], ours, memories.values())
        if not ends:
            raise NoWindow(f"{name!r} has no registers")
        address = min(ends)[0] & -mmap.PAGESIZE
        end = max([end for _, end in ends]) + mmap.PAGESIZE - 1 & -mmap.PAGESIZE
        inside = tuple([m for m in memories.values() if m.region == region and address <= m.address and m.end <= end])
        return Place(region, module, config, mode, ours, inside, address, end - address)

    def _where(self, config: Config, name: str) -> tuple[str | None, str]:
        """Region and module. Raises ModuleAbsent, NotFound."""
        place = window_place(config, name)
        if place is None:
            self._unknown(config, name)
        region, module = place
        if region == STATIC:
            return None, ""
        held = self._state.latest.region(region).module
        if module not in ("", held):
            raise ModuleAbsent(f"module {name!r} is not loaded: region {region} holds {held or 'none'}")
        return region, held or ""

    def _unknown(self, config: Config, name: str) -> NoReturn:
        for other in self._state.configs.values():
            if name in other.modules or name in other.regions:
                raise ModuleAbsent(f"module {name!r} is not loaded: it is one of configuration {other.name!r}")
        known = [*config.modules, *config.regions, *config.blocks, STATIC]
        raise NotFound(f"no module, region or block {name!r}{hint(name, known)}")

    # ---- taking back ----------------------------------------------------------------

    def revoke(self, touched: LockedRegions, config: str, mode: str) -> None:
        """Take back all of what a change has locked; the change goes to that mode. Raises DeviceError.

        When it returns nobody reaches the registers by a window, whatever its holder does.
        """
        with self._lock:
            places = {(x.place.address, x.place.length) for x in self._loans.values() if x.place.region in touched}
        for address, length in places:
            if self._lender is not None:
                self._lender.revoke(address, length)  # if it fails, they are lent still
        taken = self._take(lambda loan: loan.place.region in touched)
        until = self._time.monotonic() + _READING
        oldest = {loan.place.address: loan for loan in reversed(taken) if loan.request.write}
        for loan in oldest.values():  # once, whoever has it as well
            self._read_again(loan, until)
        for loan in taken:
            self._over(loan, _CALL, config, mode)
        if taken:
            self.changed()

    def give_back(self, number: int) -> RegValues | None:
        """A client does not want it any more, or has gone; returns what it has left in registers, to be published."""
        found = self._take(lambda loan: loan.number == number)
        changed: RegValues | None = None
        for loan in found:
            changed = self._revoke_one(loan)
            self._leases.drop(loan.lease)
            self.changed()
        return changed

    def look_at_leases(self) -> None:
        """Take back those for writing where another's lease forbids that now, or whose own has been broken."""
        for loan in self._take(self._is_overruled):
            self._revoke_one(loan)
            self._over(loan, _CALL, *self._now())
            self.changed()

    def collect(self) -> None:
        """See which the kernel has taken back, or nobody has any more."""
        ended = {event.id: int(event.reason) for event in self._lender.take()} if self._lender is not None else {}
        for loan in self._take(lambda loan: loan.id in ended):
            self._forget_values(loan, [r.name for r in loan.place.registers])
            self._over(loan, ended[loan.id], *self._now())
            self.changed()

    def forget(self) -> None:
        """The board is gone, or was started anew: so are all windows."""
        lender, self._lender = self._lender, None
        if lender is not None:
            self.closing()
            lender.close()
        for loan in self._take(lambda _: True):
            self._over(loan, _GONE, *self._now())
            self.changed()

    def fileno(self) -> int:
        """A descriptor that polls readable when there is something to `collect`; -1 before the first loan."""
        return -1 if self._lender is None else self._lender.fileno()

    def _take(self, which: Callable[[Loan], bool]) -> list[Loan]:
        with self._lock:
            taken = [loan for loan in self._loans.values() if which(loan)]
            for loan in taken:
                del self._loans[loan.number]
        return taken

    def _revoke_one(self, loan: Loan) -> RegValues | None:
        """Take one back, and note what was written in it; returns that. A region that is locked is not read."""
        with suppress(FileNotFoundError):  # nobody has it any more
            if self._lender is not None:
                self._lender.revoke_grant(loan.id)
        with self._state.lock:
            free = is_free(self._state.latest, self._state.locked, loan.place.region)
            return self._read_again(loan) if free else None

    def _over(self, loan: Loan, reason: int, config: str, mode: str) -> None:
        loan.ended(reason, config, mode)
        self._leases.drop(loan.lease)

    def _now(self) -> tuple[str, str]:
        return self._state.latest.config or "", self._state.latest.mode or ""

    def _is_overruled(self, loan: Loan) -> bool:
        if loan.lease and not self._leases.holds(loan.lease):
            return True
        if not loan.request.write:
            return False
        try:
            self._leases.check(_scopes(loan.place), f"{loan.request.lease},{loan.lease}")
        except HeldBy:
            return True
        return False

    # ---- what was written -----------------------------------------------------------

    def _read_again(self, loan: Loan, until: float | None = None) -> RegValues | None:
        """Note what a client has written: some registers, and more until `until` (of the clock); forget the rest."""
        place = loan.place
        if not loan.request.write or self._state.latest.config != place.config.name:
            return None
        found, unknown = [], []
        for number, register in enumerate(filter(_is_recorded, place.registers)):
            late = number >= _SURE and until is not None and self._time.monotonic() > until
            if not register.keeps or late:
                unknown.append(register.name)
                continue
            try:
                value = self._bus.read(register)
            except CmError:
                unknown.append(register.name)
                continue
            before = self._state.written_value(register.name)
            if value != (loan.held[register.name] if before is None else before):
                self._state.note_written(register.name, value)
                found.append(value_of(register, value))
        self._forget_values(loan, unknown)
        return RegValues(tuple(found), place.config.name, place.mode, self._state.written()) if found else None

    def _forget_values(self, loan: Loan, names: list[str]) -> None:
        if loan.request.write and self._state.latest.config == loan.place.config.name:
            known = {name for name in names if self._state.written_value(name) is not None}
            if known:
                with self._state.lock:
                    self._state.update(lambda board: board.without_values(known))


def _of_block(
    block: Block, static: tuple[Register, ...], memories: Iterable[Memory]
) -> tuple[tuple[Register, ...], list[tuple[int, int]]]:
    """A block's registers, and where they and its memories begin and end."""
    window = range(block.base_address, block.base_address + block.size)
    ours = tuple([r for r in static if r.address in window])
    ends = [(r.address, r.address + r.width // 8) for r in ours]
    return ours, ends + [(m.address, m.end) for m in memories if m.address in window and m.region is None]


def _is_recorded(register: Register) -> bool:
    """Whether what was last written to a register is kept."""
    return register.access in (Access.RW, Access.WO) and not register.volatile


def _scopes(place: Place) -> tuple[str, ...]:
    """What may be written through it, as leases have it."""
    region = [f"region:{place.region}"] if place.region else []
    registers, memories = place.registers, place.memories
    return (*region, *[f"registers:{r.name}" for r in registers], *[f"memories:{m.name}" for m in memories])


def _check_pages(place: Place) -> None:
    """Raise NoWindow where others have registers in the same pages: who maps them would have those too."""
    end = place.address + place.length
    for what, start, size in _others(place.config, place.region):
        if start < end and place.address < start + size:
            raise NoWindow(
                f"{what} lies in the pages of {place.module or place.region or 'the static part'} "
                f"(0x{place.address:x} to 0x{end - 1:x}), so they cannot be lent: a window of {mmap.PAGESIZE} bytes "
                "of its own, aligned to as many, can; the registers go by requests as before"
            )


def _others(config: Config, region: str | None) -> Iterator[tuple[str, int, int]]:
    """What is not of a region: name, address and bytes."""
    views: list[Config | Module | Mode] = [config, *config.modules.values(), *config.modes.values()]
    for view in views:
        for register in view.registers.values():
            if register.region != region:
                yield f"register {register.name!r}", register.address, register.width // 8
        for memory in view.memories.values():
            if memory.region != region:
                yield f"memory {memory.name!r}", memory.address, memory.size
    for other in config.regions.values():
        if other.decoupler is not None and other.decoupler.size:
            where = other.decoupler.base_address + other.decoupler.offset
            yield f"the decoupler of region {other.name}", where, other.decoupler.size
        if other.identity is not None and other.name != region:
            where = other.identity.base_address + other.identity.offset
            yield f"the identity of region {other.name}", where, other.identity.size


_REFUSALS = {
    errno.EINVAL: "the board's window there is no whole pages: one that is smaller than a page cannot be lent",
    errno.ENXIO: "no window of the board has all of them: one that is smaller than a page cannot be lent",
    errno.EPERM: "another driver has registers in them",
}


def _refuse(place: Place, error: OSError) -> NoReturn:
    pages = f"the pages 0x{place.address:x} to 0x{place.address + place.length - 1:x}"
    if error.errno in _REFUSALS:
        why = _REFUSALS[error.errno]
        raise NoWindow(f"{pages} cannot be lent: {why}; the registers go by requests as before") from error
    if error.errno == errno.EAGAIN:
        raise RegionBusy(f"{pages} lie in region {place.region}, which is cut off") from error
    if error.errno == errno.ENOSPC:
        raise Busy(f"{pages} cannot be lent now: the kernel has lent as many as it may") from error
    raise error

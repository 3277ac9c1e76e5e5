# SPDX-License-Identifier: Apache-2.0
"""Memories by name for requests: what is visible now, who may write, and no access to what is being changed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from cm.errors import InvalidRequest
from cm.frozen import replace
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService
from cm.manager.errors import AccessDenied, NothingLoaded, OutOfRange, RegionBusy, UnknownMemory, hint, listed
from cm.manager.state.board_state import RegionState
from cm.manager.state.journal import ManagerState
from cm.manager.status_reports import memory_info
from cm.schema.model import ITEM_BYTES, Access, Config, Memory
from cm.wire.messages.requests import DefineMemory
from cm.wire.messages.status import MemoryInfo

if TYPE_CHECKING:
    from cm.manager.interfaces import AddressRange

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_ACCESS = {"": Access.RW, "rw": Access.RW, "ro": Access.RO, "wo": Access.WO}
_WORD = 4
_Span = tuple[int, int, str, str | None]  # first address, the one after the last, what is there, its region


def requested(request: DefineMemory, config: Config) -> Memory:
    """The memory that a request describes, with its region still open. Raises InvalidRequest."""
    name = request.name
    _check_name(name, config)
    if request.address is None or not request.length:
        missing = "length" if request.length == 0 else "address"
        raise InvalidRequest(f"memory {name!r}: {missing} is missing; address and length, in bytes, define a memory")
    if request.address % _WORD or request.length % _WORD:
        place = f"{request.length} bytes at {request.address:#x}"
        raise InvalidRequest(f"memory {name!r}: {place} are not whole words: multiples of {_WORD} are")
    if request.address + request.length > 1 << 64:
        raise InvalidRequest(f"memory {name!r}: it ends behind the last address of 64 bits")
    if request.access not in _ACCESS:
        raise InvalidRequest(f"memory {name!r}: access {request.access!r}; it is one of rw, ro, wo")
    dtype = request.dtype or "uint32"
    memory = Memory(
        name, request.address, request.length, access=_ACCESS[request.access], dtype=dtype, shape=request.shape or None
    )
    _check_form(memory)
    return memory


def placed(memory: Memory, region: str, config: Config, window: AddressRange) -> Memory:
    """`memory` in the region that is named, or in that of other things with names in the same window.

    Raises InvalidRequest.
    """
    if region:
        if region != "static" and region not in config.regions:
            known = listed([*config.regions, "static"])
            raise InvalidRequest(f"memory {memory.name!r}: there is no region {region!r}; there are {known}")
        return replace(memory, region=None if region == "static" else region)
    named = list(_named(config))
    over = {owner for start, end, _, owner in named if start < memory.end and memory.address < end}
    near = {owner for start, _, _, owner in named if window.address <= start < window.address + window.size}
    owners = over or near or {None}
    if len(owners) > 1:
        names = listed(owner or "static" for owner in owners)
        raise InvalidRequest(f"memory {memory.name!r}: region is missing; its window has registers of {names}")
    return replace(memory, region=owners.pop())


def check_covered(memory: Memory, config: Config, mode: str | None, others: Iterable[Memory]) -> None:
    """Raise InvalidRequest if a writable memory covers something that has a name in `mode`."""
    if memory.access is Access.RO:
        return
    for start, end, what, _ in (*_registers(config, mode), *_memories(others), *_fixed(config)):
        if start < memory.end and memory.address < end:
            raise InvalidRequest(
                f"memory {memory.name!r} covers {what} at {start:#x}, which has rights and limits of its own: "
                "take another place, or access ro"
            )


def _check_name(name: str, config: Config) -> None:
    if not _NAME.fullmatch(name):
        raise InvalidRequest(f"memory {name[:80]!r}: letters, digits, _ and - make a name, at most 64, no digit first")
    for mode in config.modes.values():
        for kind, names in (("stream", mode.streams), ("memory", config.visible_memories(mode.name))):
            if name in names:
                raise InvalidRequest(f"{name!r} is a {kind} of configuration {config.name!r}: give another name")


def _check_form(memory: Memory) -> None:
    if memory.dtype not in ITEM_BYTES:
        raise InvalidRequest(f"memory {memory.name!r}: no dtype {memory.dtype!r}; there are {', '.join(ITEM_BYTES)}")
    if memory.shape is None:
        fits = memory.size % memory.item == 0
        form = f"whole elements of {memory.dtype}"
    else:
        fits = math.prod(memory.shape) * memory.item == memory.size
        form = f"shape {list(memory.shape)} of {memory.dtype}"
    if not fits:
        raise InvalidRequest(f"memory {memory.name!r}: its {memory.size} bytes are not {form}")


def _named(config: Config) -> Iterator[_Span]:
    """Every place that has a name in some mode."""
    for mode in config.modes:
        yield from _registers(config, mode)
        yield from _memories(config.visible_memories(mode).values())
    yield from _fixed(config)


def _registers(config: Config, mode: str | None) -> Iterator[_Span]:
    for r in config.visible_registers(mode).values():
        yield r.address, r.address + r.width // 8, f"register {r.name!r}", r.region


def _memories(memories: Iterable[Memory]) -> Iterator[_Span]:
    for m in memories:
        yield m.address, m.end, f"memory {m.name!r}", m.region


def _fixed(config: Config) -> Iterator[_Span]:
    for name, region in config.regions.items():
        for what, part, owner in (("decoupler", region.decoupler, None), ("identity", region.identity, name)):
            if part is not None and part.size:
                start = part.base_address + part.offset
                yield start, start + part.size, f"the {what} of region {name!r}", owner


LENGTH_MAX = 4 << 20  # bytes of one request
PIECE = 8 << 10  # bytes of a piece; registers and changes wait for one at most


class MemoryService:
    """Finds memories, defines them, and begins transfers. One lock with `RegisterService`, so that a change waits."""

    def __init__(self, state: ManagerState, registers: RegisterService, bus: RegisterBus, leases: Leases) -> None:
        self._state = state
        self._registers = registers
        self._bus = bus
        self._leases = leases
        self._modes: tuple[Config | None, Mapping[str, tuple[str, ...]]] = None, {}  # of each memory of a configuration

    def visible(self) -> Mapping[str, Memory]:
        """All memories that can be named now: the schema's in this mode, and those defined at run time.

        Raises NothingLoaded.
        """
        with self._state.lock:
            return {**self._loaded().visible_memories(self._state.latest.mode), **self._state.runtime_memories}

    def find(self, name: str) -> Memory | None:
        """The memory of that name; None if there is none. Raises UnknownMemory for one of other modes."""
        state = self._state.latest
        config = self._state.configs.get(state.config or "")
        if config is None:
            return None
        if name in self._state.runtime_memories:
            return self._state.runtime_memories[name]
        modes = self._modes_with(config).get(name)
        if modes is None:
            return None
        memory = config.visible_memories(state.mode).get(name)
        if memory is None:
            raise UnknownMemory(f"no memory {name!r} in this mode ({state.mode}); modes {', '.join(modes)} have it")
        return memory

    def _modes_with(self, config: Config) -> Mapping[str, tuple[str, ...]]:
        """The modes in which each memory can be named; kept, since every request for a frame asks for it."""
        if self._modes[0] is not config:
            found: dict[str, tuple[str, ...]] = {}
            for mode in config.modes:
                for name in config.visible_memories(mode):
                    found[name] = (*found.get(name, ()), mode)
            self._modes = config, found
        return self._modes[1]

    def check_no_memory(self, name: str) -> None:
        """Raise InvalidRequest if this is a memory's name, since only streams have settings."""
        if self.find(name) is not None:
            raise InvalidRequest(
                f"memory {name!r} is not a stream: only one that was defined at run time can be defined again, "
                "with address and length"
            )

    def named(self, name: str) -> Memory:
        """The memory of that name. Raises UnknownMemory with what there is, NothingLoaded."""
        memory = self.find(name)
        if memory is None:
            raise UnknownMemory(f"no memory {name!r}{hint(name, self.visible())}")
        return memory

    def listed(self) -> str:
        """All names, for a sentence; empty where there are none."""
        config = self._state.loaded_config()
        names = self.visible() if config else ()
        return f"; memories are {listed(names)}" if names else ""

    def info(self, memory: Memory) -> MemoryInfo:
        """The description of a memory that can be named now."""
        return memory_info(memory, defined=memory.name in self._state.runtime_memories)

    def defined(self) -> tuple[MemoryInfo, ...]:
        """Those that were defined at run time."""
        return tuple(memory_info(memory, defined=True) for memory in self._state.runtime_memories.values())

    def define(self, request: DefineMemory) -> Memory:
        """Define a memory until the configuration changes, or again. Raises InvalidRequest, DeviceNotFound, HeldBy."""
        config = self._loaded()
        memory = requested(request, config)
        window = self._bus.place(memory.address, memory.size)
        memory = placed(memory, request.region, config, window.device.maps[window.map])
        self._check_covered(memory)
        self._leases.check(_scopes(memory), request.lease)
        self._state.define(memory)
        return memory

    def begin_read(self, name: str, offset: int, length: int) -> Transfer:
        """Begin a read, which moves nothing yet; length 0 means the rest.

        Raises UnknownMemory, AccessDenied, OutOfRange, …
        """
        memory = self.named(name)
        if memory.access is Access.WO:
            raise AccessDenied(f"memory {name!r} is write-only")
        length = length or max(memory.size - offset, 0)
        _check_range(memory, offset, length)
        self._registers.check_region(memory.region, f"memory {name!r}")
        return Transfer(self, memory, offset, length)

    def begin_write(self, name: str, offset: int, data: bytes | memoryview, lease: str) -> Transfer:
        """Begin a write, which moves nothing yet. Raises as `begin_read`, HeldBy, RecordFailed."""
        memory = self.named(name)
        if memory.access is Access.RO:
            raise AccessDenied(f"memory {name!r} is read-only")
        view = memoryview(data).cast("B")
        _check_range(memory, offset, len(view))
        self._check_covered(memory)
        self._leases.check(_scopes(memory), lease)
        self._registers.check_region(memory.region, f"memory {name!r}")
        self._state.check_kept()
        return Transfer(self, memory, offset, len(view), view)

    def move(self, transfer: Transfer, start: int, end: int) -> None:
        """Move a piece of a transfer. Raises RegionBusy, UnknownMemory if it no longer exists, DeviceError."""
        memory, place = transfer.memory, transfer.offset + start
        with self._state.lock:
            if self.named(memory.name) != memory:
                raise UnknownMemory(f"memory {memory.name!r} is another one now, in mode {self._state.latest.mode!r}")
            self._registers.check_region(memory.region, f"memory {memory.name!r}")
            if self.holding(memory) is not transfer.holding:
                done = f"{start} of {transfer.length} bytes had been moved"
                raise RegionBusy(f"memory {memory.name!r}: region {memory.region} was changed meanwhile; {done}")
            if transfer.write:
                self._bus.write_block(memory, place, transfer.data[start:end])
            else:
                transfer.data[start:end] = self._bus.read_block(memory, place, end - start)

    def holding(self, memory: Memory) -> RegionState | None:
        """What a memory's region holds: a different object after each of its changes."""
        return self._state.latest.region(memory.region) if memory.region else None

    def _loaded(self) -> Config:
        config = self._state.loaded_config()
        if config is None:
            raise NothingLoaded("nothing is loaded, so there are no memories")
        return config

    def _check_covered(self, memory: Memory) -> None:
        """A writable block must not cover anything that has rights and limits of its own in this mode."""
        if memory.name in self._loaded().visible_memories(self._state.latest.mode):
            return  # the schema's: checked when it was read
        views = {
            name for name, block in self._state.runtime_memories.items() if block.access is Access.RO
        }  # no rights to keep
        others = [other for name, other in self.visible().items() if name != memory.name and name not in views]
        check_covered(memory, self._loaded(), self._state.latest.mode, others)


class Transfer:
    """A read or write under way; `data` is what was read so far, or what is written."""

    __slots__ = ("_done", "_service", "data", "holding", "length", "memory", "offset", "write")

    def __init__(
        self, service: MemoryService, memory: Memory, offset: int, length: int, written: memoryview | None = None
    ) -> None:
        self._service, self.memory, self.offset, self.length = service, memory, offset, length
        self.write = written is not None
        self.data = memoryview(b"") if written is None else written
        self.holding = service.holding(memory)
        self._done = 0

    def step(self) -> bool:
        """Move the next piece; returns whether that was the last. Raises as `MemoryService.move`."""
        if not self.write and not self._done:
            self.data = memoryview(bytearray(self.length))  # not before its turn
        end = min(self._done + PIECE, self.length)
        self._service.move(self, self._done, end)
        self._done = end
        return end == self.length

    @property
    def form(self) -> tuple[tuple[int, ...], str]:
        """Shape and dtype of the bytes; plain bytes if they are not whole elements."""
        memory, length = self.memory, self.length
        if self.offset % memory.item or length % memory.item:
            return (length,), "uint8"
        whole = length == memory.size and memory.shape
        return whole or (length // memory.item,), memory.dtype


def _check_range(memory: Memory, offset: int, length: int) -> None:
    if offset % _WORD or length % _WORD:
        raise InvalidRequest(
            f"memory {memory.name!r}: {length} bytes at offset {offset} are not whole words: multiples of {_WORD} are"
        )
    if offset + length > memory.size or not length:
        there = f"it has {memory.size}, and one word is the least"
        raise OutOfRange(f"memory {memory.name!r}: {length} bytes at offset {offset}; {there}")
    if length > LENGTH_MAX:
        raise OutOfRange(
            f"memory {memory.name!r}: {length} bytes in one request; {LENGTH_MAX} is the most, ask for parts by offset"
        )


def _scopes(memory: Memory) -> tuple[str, ...]:
    region = (f"region:{memory.region}",) if memory.region else ()
    return (f"memories:{memory.name}", *region)

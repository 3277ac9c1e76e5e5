# SPDX-License-Identifier: Apache-2.0
"""The words of a board by address: each goes by the name of its register or memory."""

from __future__ import annotations

import select
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from operator import index
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from cm.client.core import calls, memory, registers
from cm.client.errors import BoardClosed, ConnectionLost, RequestFailed, WindowRevoked
from cm.errors import Forbidden, InvalidRequest, NotFound, Timeout
from cm.wire.lazy_numpy import np
from cm.wire.messages.status import BlockInfo, MemoryInfo, RegisterInfo, Status

if TYPE_CHECKING:
    from cm.client.core.calls import Call
    from cm.client.events import EventStream
    from cm.client.interrupts import Interrupts
    from cm.client.memories import Memories, Memory
    from cm.client.register_window import RegisterWindow
    from cm.client.registers import Registers

_T = TypeVar("_T")

WORD = 4
WHOLE = 0xFFFFFFFF


class AnyBoard(Protocol):
    """What a `cm.client.board.Board` has of words."""

    registers: Registers
    memories: Memories
    interrupts: Interrupts

    @property
    def status(self) -> Status:
        """The state of the PL now."""

    def ask(self, call: Call[_T]) -> _T:
        """Make a call and return its result."""

    def watch(self) -> EventStream[Status]:
        """Every status from now on."""


class Places:
    """What the current mode has at an address; asked for again as soon as the board has another mode."""

    def __init__(self, found: AnyBoard) -> None:
        self._board = found
        self._lock = threading.RLock()
        self._statuses = found.watch()
        self._ready = _ready(self._statuses.fileno())
        self._change: object = None
        self._words: dict[int, tuple[RegisterInfo, int]] = {}  # with the first bit of the word
        self._registers: tuple[RegisterInfo, ...] = ()
        self._blocks: tuple[BlockInfo, ...] = ()
        self._windows: dict[str, RegisterWindow | None] = {}  # by block; None: its registers go by requests
        self._memories: list[MemoryInfo] = []
        self._written: dict[int, int] = {}  # words of write-only registers as this program wrote them

    def read(self, address: int) -> int:
        """A word; of a write-only register what was written last. Raises NotFound where nothing is described."""
        return self.reader(address)()

    def reader(self, address: int) -> Callable[[], int]:
        """What reads a word as often as it is called: by a load, where the board lends the window of its block."""
        load: Callable[[], int] | None = None

        def read() -> int:
            nonlocal load
            try:
                if load is not None:
                    return load()
            except (WindowRevoked, BoardClosed):  # the latter: somebody has asked what there is now
                pass
            load = self._load(address)
            return self._ask(address) if load is None else load()

        return read

    def _ask(self, address: int) -> int:
        info, place = self._at(address)
        if isinstance(info, MemoryInfo):
            return int(self._board.memories[info.name].read(place, WORD).view("<u4")[0])
        if info.access == "wo" and address in self._written:
            return self._written[address]
        return self._board.registers[info.name] >> place & WHOLE

    def _load(self, address: int) -> Callable[[], int] | None:
        """What reads a word by one load, until it raises WindowRevoked; None where the word goes by requests."""
        with self._lock:
            info, _ = self._at(address)
            plain = not info.defined if isinstance(info, MemoryInfo) else info.width <= 32 and info.access != "wo"
            for block in self._blocks if plain else ():
                if block.base_address <= address < block.base_address + block.size:
                    window = self._window(block.name)
                    return None if window is None else window.word(address)
        return None

    def _window(self, name: str) -> RegisterWindow | None:
        """The window of a block, for reading; there is none without the right, the kernel module or the machine."""
        found = self._windows.get(name)
        if name not in self._windows or (found is not None and found.revoked):
            if found is not None:
                found.close()
            self._windows[name] = None
            with suppress(RequestFailed, ConnectionLost, Timeout, InvalidRequest, Forbidden, NotFound):
                self._windows[name] = self._board.registers.window(name, write=False)
        return self._windows[name]

    def write(self, address: int, value: int, mask: int = WHOLE) -> None:
        """Write a word, or the bits of it in `mask`; those of a register by one request.

        Raises as `read`, ValueError for what is no integer from -2^31 to 2^32 - 1.
        """
        value = _word(value)
        info, place = self._at(address)
        if isinstance(info, MemoryInfo):
            value = value if mask == WHOLE else self.read(address) & ~mask | value & mask
            self._board.memories[info.name].write(value.to_bytes(WORD, "little"), place)
        elif mask == WHOLE and info.width <= 32:
            self._board.registers[info.name] = value
            self._written[address] = value
        else:
            value = self._board.registers.write_masked(info.name, value << place, mask << place)
            self._written[address] = value >> place & WHOLE

    def words(self, address: int, size: int) -> Words:
        """Those of a window of `size` bytes."""
        return Words(self, range(address, address + size // WORD * WORD, WORD))

    def memory(self, where: range) -> tuple[Memory | None, int]:
        """The memory that has all words at these addresses, which follow each other, and where; None: none has."""
        info, place = self._at(where[0]) if where.step == WORD and where else (None, 0)
        if isinstance(info, MemoryInfo) and where[-1] + WORD <= info.address + info.size:
            return self._board.memories[info.name], place
        return None, 0

    def registers(self, block: BlockInfo) -> list[RegisterInfo]:
        """The registers in a block's window."""
        with self._lock:
            self._current()
            return [r for r in self._registers if block.base_address <= r.address < block.base_address + block.size]

    def memories(self, block: BlockInfo) -> list[MemoryInfo]:
        """The memories in a block's window."""
        with self._lock:
            self._current()
            return [m for m in self._memories if block.base_address <= m.address < block.base_address + block.size]

    def refresh(self) -> None:
        """Ask what there is now."""
        with self._lock:
            change = _change(self._board.status)
            if change != self._change:
                self._written.clear()
            self._change = change
            described = self._board.ask(calls.describe())
            self._registers = tuple(registers.visible(described).values())
            self._words = {
                info.address + WORD * part: (info, 32 * part)
                for info in self._registers
                for part in range(max(1, info.width // 32))
            }
            self._blocks = described.blocks
            for window in self._windows.values():
                if window is not None:
                    window.close()
            self._windows.clear()
            self._memories = list(memory.visible(described).values())

    def _at(self, address: int) -> tuple[RegisterInfo | MemoryInfo, int]:
        """A register with the first bit of the word, or a memory with its offset."""
        with self._lock:
            self._current()
            if address in self._words:
                return self._words[address]
            for info in self._memories:
                if info.address <= address < info.address + info.size:
                    return info, address - info.address
        raise NotFound(f"the loaded configuration describes neither a register nor a memory at {address:#x}")

    def _current(self) -> None:
        if self._change is None or self._changed():
            self.refresh()

    def _changed(self) -> bool:
        changed = False
        if self._ready():
            while (status := self._statuses.poll()) is not None:
                changed = changed or _change(status) != self._change
        return changed


class Words:
    """The words of a window by index and slice, as a numpy array has them; reads are copies.

    Those of a memory that follow each other go by one request, others one by one.
    """

    def __init__(self, places: Places, where: range) -> None:
        self._places, self._where = places, where

    def __len__(self) -> int:
        return len(self._where)

    def __getitem__(self, key: int | slice) -> Any:
        """A word, or an array of them. Raises NotFound where nothing is described, IndexError."""
        if not isinstance(key, slice):
            return np.uint32(self._places.read(self._where[key]))
        where = self._where[key]
        memory, place = self._places.memory(where)
        if memory is None:
            return np.array([self._places.read(address) for address in where], np.uint32)
        return np.asarray(memory.read(place, WORD * len(where)).reshape(-1).view("<u4"), np.uint32)

    def __setitem__(self, key: int | slice, value: Any) -> None:
        """Write a word, or as many as the slice has. Raises ValueError for what is no integer of 32 bits."""
        if not isinstance(key, slice):
            self._places.write(self._where[key], value)
            return
        where = self._where[key]
        words = [_word(one) for one in np.broadcast_to(value, len(where)).tolist()]
        memory, place = self._places.memory(where)
        if memory is not None:
            memory.write(np.array(words, "<u4").tobytes(), place)
            return
        for address, one in zip(where, words, strict=True):
            self._places.write(address, one)


def _word(value: int) -> int:
    """An integer as a word, negative ones too. Raises ValueError for what is none."""
    try:
        number = index(value)
    except TypeError:
        raise ValueError(f"a word is an integer, not {type(value).__name__}") from None
    if not -(1 << 31) <= number <= WHOLE:
        raise ValueError(f"{number} is not a number of 32 bits")
    return number & WHOLE


def _ready(fd: int) -> Callable[[], bool]:
    """Whether something may have come on a descriptor; where there is no poll(2), ZeroMQ has to be asked each time."""
    if sys.platform == "win32":
        return lambda: True
    poll = select.poll()
    poll.register(fd, select.POLLIN)
    return lambda: bool(poll.poll(0))


def _change(status: Status) -> object:
    return status.config_name, status.mode, status.last_change

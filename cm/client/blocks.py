# SPDX-License-Identifier: Apache-2.0
"""Blocks of the design, by instance: ``board.blocks["cnn_top_0"].write(0x10, 7)``; classes for them by VLNV."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from cm.client.core import calls, typed_values
from cm.client.errors import RequestNotFound
from cm.client.places import AnyBoard, Places, Words
from cm.errors import NotFound
from cm.wire.messages.status import BlockInfo, ErrorInfo, RegisterInfo

if TYPE_CHECKING:
    from cm.client.interrupts import Interrupt
    from cm.client.memories import Memory

_C = TypeVar("_C", bound="type[Block]")
_drivers: dict[str, type[Block]] = {}


def driver(*vlnvs: str) -> Callable[[_C], _C]:
    """Bind a subclass of `Block` to VLNVs: ``board.blocks`` gives it for them.

    Without its version (``xilinx.com:hls:cnn_top``) a VLNV is any version's for which nothing else is bound.
    """

    def bind(kind: _C) -> _C:
        _drivers.update(dict.fromkeys(vlnvs, kind))
        return kind

    return bind


class BlockRegisters(MutableMapping[str, float]):
    """A block's registers by their own names, as the numbers that the schema's `type` and `fraction` make of the bits.

    Fields (``"ctrl.ap_start"``) are whole numbers.
    """

    def __init__(self, block: Block) -> None:
        self._block = block

    @property
    def info(self) -> dict[str, RegisterInfo]:
        """What the schema says of each; names are those in the block."""
        prefix = self._block.info.prefix
        return {info.name.removeprefix(prefix): info for info in self._block._places.registers(self._block.info)}

    def __getitem__(self, name: str) -> float:
        info, field = self._find(name)
        value = self._block.board.registers[info.name + field]
        return value if field else typed_values.decoded(info, value)

    def __setitem__(self, name: str, value: float | str) -> None:
        info, field = self._find(name)
        plain: Any = value  # a field's value, which may be a name
        bits = plain if field or isinstance(value, str) else typed_values.encoded(info, value)
        self._block.board.registers[info.name + field] = bits

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register cannot be deleted")

    def __iter__(self) -> Iterator[str]:
        return iter(self.info)

    def __len__(self) -> int:
        return len(self.info)

    def _find(self, name: str) -> tuple[RegisterInfo, str]:
        register, dot, field = name.partition(".")
        known = self.info
        if register not in known:
            there = ", ".join(known) or "none"
            said = f"block {self._block.name!r} has no register {register!r}; there are {there}"
            raise RequestNotFound(ErrorInfo("unknown_register", said))
        return known[register], dot + field

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)


class Block:
    """An IP. Every access goes by the name of a register or memory: rights, limits and leases hold."""

    def __init__(self, board: AnyBoard, info: BlockInfo, places: Places) -> None:
        """Made by ``board.blocks``; a subclass that needs more adds methods."""
        self.board, self.info, self._places = board, info, places
        self.name, self.vlnv = info.name, info.vlnv
        self.registers = BlockRegisters(self)

    def read(self, offset: int = 0) -> int:
        """The word at `offset` bytes. Raises NotFound where the schema describes nothing, IndexError outside."""
        return self._places.read(self._address(offset))

    def write(self, offset: int, value: int) -> None:
        """Write a word. Raises as `read`."""
        self._places.write(self._address(offset), value)

    @property
    def words(self) -> Words:
        """Its window, by index and slice: ``block.words[4:8] = [1, 2, 3, 4]``."""
        return self._places.words(self.info.base_address, self.info.size)

    @property
    def memory(self) -> Memory:
        """Its memory. Raises NotFound where it has none or several, which ``board.memories`` has by name."""
        names = [info.name for info in self._places.memories(self.info)]
        return self.board.memories[_only(names, f"block {self.name!r}", "memory")]

    @property
    def interrupt(self) -> Interrupt:
        """Its interrupt. Raises NotFound where it has none or several, which ``board.interrupts`` has by name."""
        return self.board.interrupts[_only(self.info.interrupts, f"block {self.name!r}", "interrupt")]

    def _address(self, offset: int) -> int:
        if not 0 <= offset <= self.info.size - 4:
            raise IndexError(f"no word at {offset:#x} in block {self.name!r} of {self.info.size:#x} bytes")
        return self.info.base_address + offset

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.vlnv or 'no VLNV'} at {self.info.base_address:#x}>"


def _only(names: tuple[str, ...] | list[str], whose: str, what: str) -> str:
    if len(names) != 1:
        raise NotFound(f"{whose} has " + (f"several of them: {', '.join(names)}" if names else f"no {what}"))
    return names[0]


class Blocks(Mapping[str, Block]):
    """The blocks of the loaded configuration by instance."""

    def __init__(self, board: AnyBoard) -> None:
        self._board = board

    @cached_property
    def _places(self) -> Places:
        """The words of the board by address."""
        return Places(self._board)

    @property
    def info(self) -> dict[str, BlockInfo]:
        """What the schema says of each."""
        return {info.name: info for info in self._board.ask(calls.describe()).blocks}

    def __getitem__(self, name: str) -> Block:
        """The block, in the class that `driver` has bound to its VLNV. Raises KeyError with those that there are."""
        known = self.info
        if name not in known:
            raise KeyError(f"no block {name!r}; there are {', '.join(known) or 'none'}")
        info = known[name]
        kind = _drivers.get(info.vlnv) or _drivers.get(info.vlnv.rpartition(":")[0], Block)
        return kind(self._board, info, self._places)

    def __iter__(self) -> Iterator[str]:
        return iter(self.info)

    def __len__(self) -> int:
        return len(self.info)

    def __repr__(self) -> str:
        return f"<blocks of {self._board!r}>"

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.info)

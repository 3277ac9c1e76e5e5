# SPDX-License-Identifier: Apache-2.0
"""Models with a state: one object for each load of a module, with its registers, memories, streams and interrupts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Registers(MutableMapping[str, int]):
    """The registers of a module by name: what is written here is read on the bus, and vice versa."""

    def __init__(self, cells: Mapping[str, Any]) -> None:
        self._cells = cells

    def __getitem__(self, name: str) -> int:
        return int(self._cells[name].value)

    def __setitem__(self, name: str, value: int) -> None:
        self._cells[name].value = value

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register cannot be deleted")

    def __iter__(self) -> Iterator[str]:
        return iter(self._cells)

    def __len__(self) -> int:
        return len(self._cells)


class Surroundings(Protocol):
    """What a model may do to the board."""

    def interrupt(self, name: str) -> None:
        """Raise an interrupt of the schema. Raises SimError for an unknown one."""

    def memory(self, address: int, length: int) -> NDArray[Any]:
        """Bytes of main memory as a master in the PL has them. Raises SimError where none was allocated."""

    def send(self, stream: str, data: Any) -> bool:
        """Let a packet leave on a stream to memory; False if too many wait already, and it is lost."""

    def after(self, seconds: float, call: Callable[[], object]) -> None:
        """Do something later, unless another module has been loaded by then."""


class Model:
    """Base of models with a state. It is made when its module has been loaded, and forgotten with it.

    `registers` are those of the module, the configuration and the static part; `memories` are numpy arrays of the
    shape that the schema gives, over the bytes that the bus sees. `outputs` names the streams to memory that the
    model fills itself, by `board.send`: nothing else comes on them.
    """

    outputs: ClassVar[tuple[str, ...]] = ()

    def __init__(self, registers: Registers, memories: Mapping[str, NDArray[Any]], board: Surroundings) -> None:
        self.registers = registers
        self.memories = memories
        self.board = board
        self.start()

    def start(self) -> None:
        """The module was loaded: registers are at their reset, memories zero."""

    def written(self, register: str, value: int) -> None:
        """The bus has written a register; `value` is what it holds now."""

    def frame(self, stream: str, frame: NDArray[Any]) -> NDArray[Any] | None:
        """A packet came in on the channel `stream`: (height, width) bytes, read-only.

        Returns what leaves; None: nothing.
        """
        del stream
        return frame

    def stop(self) -> None:
        """The module's region is about to be loaded anew."""

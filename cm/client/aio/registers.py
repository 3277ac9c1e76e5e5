# SPDX-License-Identifier: Apache-2.0
"""Registers of the asyncio client: ``await board.registers.write({"focus": 2})``."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar, overload

from cm.client.aio.events import EventStream
from cm.client.core import calls, registers
from cm.client.core.calls import Value, Writes
from cm.client.core.events import RegisterEvents
from cm.client.core.flow_effects import DEFAULT, Limit
from cm.client.core.generations import Written
from cm.client.errors import RequestNotFound
from cm.wire.messages.status import RegisterInfo, RegValues
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    from cm.client.aio.request_reply import Caller
    from cm.client.connections import ByName
    from cm.client.register_window import RegisterWindow

_T = TypeVar("_T")


class Registers:
    """Registers (``"focus"``) and fields (``"control.enable"``) of the current mode by name."""

    def __init__(
        self,
        board: Caller,
        open_window: Callable[[Open, Limit], Awaitable[RegisterWindow]],
        reads: ByName,
    ) -> None:
        """`reads`: what needs no request."""
        self._board = board
        self._open_window = open_window
        self._reads = reads

    async def window(
        self,
        name: str,
        *,
        write: bool = True,
        wait: bool = False,
        exclusive: bool = False,
        timeout: Limit = DEFAULT,
        lease: str = "",
    ) -> RegisterWindow:
        """Map registers, as the blocking client: ``with await board.registers.window("edge") as regs: regs.focus = 2``.

        An access is a load or a store and is not awaited. So `wait` waits until the module is there, and an access
        whose pages were taken back raises WindowRevoked with it too: ask for another window then.
        """
        purpose = Purpose.WRITABLE_WINDOW if write else Purpose.WINDOW
        wanted = Open(name, purpose, lease=lease, exclusive=exclusive, wait=wait)
        return await self._open_window(wanted, timeout)

    @overload
    async def get(self, name: str, default: None = None) -> int | None: ...
    @overload
    async def get(self, name: str, default: _T) -> int | _T: ...
    async def get(self, name: str, default: Any = None) -> Any:
        """The value of a register or field; `default` if the current mode has none of that name."""
        try:
            return (await self.read(name)).popitem()[1]
        except RequestNotFound:
            return default

    async def info(self) -> dict[str, RegisterInfo]:
        """What the schema says about each register of the current mode."""
        return registers.visible(await self._board.ask(calls.describe()))

    async def generation(self) -> int:
        """The registers' current generation: grows with every write by any client, and with every change of mode."""
        return (await self._board.ask(calls.status())).generation

    async def read(self, *names: str) -> dict[str, int]:
        """Values of several registers at once; by default of all that can be read."""
        if len(names) == 1 and (value := self._reads.read(names[0])) is not None:
            await asyncio.sleep(0)  # the others' turn: who polls a register would let nobody else run
            return {names[0]: value}
        return registers.values(await self._board.ask(calls.read_registers(names)))

    # mypy finds no type for a dict of numbers and names where it is wanted for one of two
    @overload
    async def write(self, values: Mapping[str, Value], lease: str = "") -> Written: ...
    @overload
    async def write(self, values: Iterable[tuple[str, Value]], lease: str = "") -> Written: ...
    async def write(self, values: Writes, lease: str = "") -> Written:
        """Write several registers in order; all are checked before the first is written. Returns the new values.

        Pairs can name a register several times: ``[("control.start", 1), ("control.start", 0)]`` is a pulse.
        Values are integers, or names that the schema gives to a field's values: ``{"led.colour": "red"}``. The result's
        `generation` is what frames after the write have at least (`stream.after`).
        """
        return Written(await self._board.ask(calls.write_registers(values, lease)))

    async def write_masked(self, name: str, value: int, mask: int, lease: str = "") -> int:
        """Write only the bits in `mask`; returns the register's value."""
        return (await self._board.ask(calls.write_masked(name, value, mask, lease))).values[0].value

    def events(self, *names: str, timeout: float | None = None) -> EventStream[RegValues]:
        """All writes after it is opened, by any client, with the values afterwards; `names`: only of these registers.

        Of a field: those of its register. A register of another mode is waited for; a name that no mode of the loaded
        configuration has raises RequestNotFound. Raises Timeout if none comes for `timeout` seconds (None: waits for
        ever).
        """
        subscription = self._board.subscribe(*RegisterEvents.topics)
        return EventStream(self._board, subscription, RegisterEvents(subscription, timeout, names))

    if not TYPE_CHECKING:  # to a type checker they would allow any name

        def __getitem__(self, name: str) -> int:
            raise TypeError(f"await board.registers.read({name!r}), or get({name!r}): brackets cannot be awaited")

        def __setitem__(self, name: str, value: int) -> None:
            raise TypeError(f"await board.registers.write({{{name!r}: {value!r}}}): an assignment cannot be awaited")

        def __setattr__(self, name: str, value: Any) -> None:
            if name.startswith("_"):
                object.__setattr__(self, name, value)
                return
            raise AttributeError(f"await board.registers.write({{{name!r}: {value!r}}})")

    def __repr__(self) -> str:
        return f"<registers of {self._board!r}>"

# SPDX-License-Identifier: Apache-2.0
"""Registers of the blocking client: ``board.registers["focus"] = 2``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING, Any, TypeVar, overload

from cm.client.core import calls, registers
from cm.client.core.calls import Value, Writes
from cm.client.core.events import RegisterEvents
from cm.client.core.flow_effects import DEFAULT, Limit
from cm.client.core.generations import Written
from cm.client.errors import RequestNotFound
from cm.client.events import EventStream
from cm.wire.messages import notebook
from cm.wire.messages.status import RegisterInfo, RegValues
from cm.wire.plane_packets import Open, Purpose

if TYPE_CHECKING:
    from cm.client.connections import ByName
    from cm.client.register_window import RegisterWindow
    from cm.client.request_reply import Caller

_T = TypeVar("_T")


class Registers(MutableMapping[str, int]):
    """Registers (``"focus"``) and fields (``"control.enable"``) of the current mode by name."""

    def __init__(
        self,
        board: Caller,
        open_window: Callable[[Open, Limit], RegisterWindow],
        reads: ByName,
    ) -> None:
        """`reads`: what needs no request."""
        self._board = board
        self._open_window = open_window
        self._reads = reads

    def window(
        self,
        name: str,
        *,
        write: bool = True,
        wait: bool = False,
        exclusive: bool = False,
        timeout: Limit = DEFAULT,
        lease: str = "",
    ) -> RegisterWindow:
        """Map the registers of a module, of what a region holds, of a block, or of the static part ("static").

        A context manager whose attributes are the registers: each access is one load or store. The manager takes the
        pages back when the region is reconfigured, and each access raises WindowRevoked from then on; with `wait` it
        goes on as soon as the same module is there again. `exclusive`: a lease on the region goes with it, so that
        others can neither write there nor change it. `timeout`: seconds to wait for the pages; with `wait` for ever.
        On the manager's machine only; needs the role `map`. Raises RequestFailed ("no_window" where they cannot be
        mapped: the registers go by requests as before), RequestBusy.
        """
        purpose = Purpose.WRITABLE_WINDOW if write else Purpose.WINDOW
        return self._open_window(Open(name, purpose, lease=lease, exclusive=exclusive, wait=wait), timeout)

    def __getitem__(self, name: str) -> int:
        value = self._reads.read(name)
        return self._board.ask(calls.read_registers((name,))).values[0].value if value is None else value

    def __setitem__(self, name: str, value: Value) -> None:
        self._board.ask(calls.write_registers({name: value}))

    def __delitem__(self, name: str) -> None:
        raise TypeError("a register cannot be deleted")

    def __iter__(self) -> Iterator[str]:
        """Names of all that the current mode has, write-only ones too; no register is read. `read` gives values."""
        return iter(self.info)

    def __len__(self) -> int:
        return len(self.info)

    def __contains__(self, name: object) -> bool:
        return registers.has(self.info, name)

    @overload
    def get(self, name: str, default: None = None) -> int | None: ...
    @overload
    def get(self, name: str, default: _T) -> int | _T: ...
    def get(self, name: str, default: Any = None) -> Any:
        """The value of a register or field; `default` if the current mode has none of that name."""
        try:
            return self[name]
        except RequestNotFound:
            return default

    @property
    def info(self) -> dict[str, RegisterInfo]:
        """What the schema says about each register of the current mode."""
        return registers.visible(self._board.ask(calls.describe()))

    @property
    def generation(self) -> int:
        """The registers' current generation: grows with every write by any client, and with every change of mode."""
        return self._board.ask(calls.status()).generation

    def read(self, *names: str) -> dict[str, int]:
        """Values of several registers at once; by default of all that can be read."""
        if len(names) == 1:
            return {names[0]: self[names[0]]}
        return registers.values(self._board.ask(calls.read_registers(names)))

    # mypy finds no type for a dict of numbers and names where it is wanted for one of two
    @overload
    def write(self, values: Mapping[str, Value], lease: str = "") -> Written: ...
    @overload
    def write(self, values: Iterable[tuple[str, Value]], lease: str = "") -> Written: ...
    def write(self, values: Writes, lease: str = "") -> Written:
        """Write several registers in order; all are checked before the first is written. Returns the new values.

        Pairs can name a register several times: ``[("control.start", 1), ("control.start", 0)]`` is a pulse.
        Values are integers, or names that the schema gives to a field's values: ``{"led.colour": "red"}``. The result's
        `generation` is what frames after the write have at least (`stream.after`).
        """
        return Written(self._board.ask(calls.write_registers(values, lease)))

    def update(self, values: Any = (), /, **named: Value) -> None:
        """Write several registers as `write` does, in one request."""
        pairs = [*(values.items() if isinstance(values, Mapping) else values), *named.items()]
        if pairs:
            self.write(pairs)

    def write_masked(self, name: str, value: int, mask: int, lease: str = "") -> int:
        """Write only the bits in `mask`; returns the register's value."""
        return self._board.ask(calls.write_masked(name, value, mask, lease)).values[0].value

    def events(self, *names: str, timeout: float | None = None) -> EventStream[RegValues]:
        """All writes from now on, by any client, with the values afterwards; `names`: only of these registers.

        Of a field: those of its register. A register of another mode is waited for; a name that no mode of the loaded
        configuration has raises RequestNotFound. Raises Timeout if none comes for `timeout` seconds (None: waits for
        ever).
        """
        subscription = self._board.subscribe(*RegisterEvents.topics)
        return EventStream(self._board, subscription, RegisterEvents(subscription, timeout, names))

    if not TYPE_CHECKING:  # to a type checker it would allow any name

        def __getattr__(self, name: str) -> int:
            """``registers.focus``, for reading."""
            if name.startswith("_"):
                raise AttributeError(name)
            try:
                return self[name]
            except RequestNotFound as error:
                raise AttributeError(str(error)) from error

        def __setattr__(self, name: str, value: Any) -> None:
            if name.startswith("_"):
                object.__setattr__(self, name, value)
                return
            raise AttributeError(registers.not_by_attribute(name, value))

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(n for n in self.info if n.isidentifier())]

    def __repr__(self) -> str:
        return f"<registers of {self._board!r}>"

    def _repr_html_(self) -> str:
        """For notebooks: what the schema says of each, and what it holds now."""
        return notebook.registers(self.info.values(), self.read())

    def _ipython_key_completions_(self) -> list[str]:
        return registers.names(self.info.values())

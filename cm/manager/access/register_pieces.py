# SPDX-License-Identifier: Apache-2.0
"""Many registers in one request, some at a time: in between, others are served and changes may begin."""

from __future__ import annotations

from contextlib import suppress
from time import monotonic_ns

from cm.errors import CmError
from cm.manager.access.register_service import RegisterService
from cm.wire.messages.requests import RegWrite
from cm.wire.messages.status import RegValue, RegValues

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

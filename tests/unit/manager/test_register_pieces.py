# SPDX-License-Identifier: Apache-2.0
"""Long requests for registers are cut into pieces as long as the loop can wait, however slow an access is."""

from __future__ import annotations

from typing import Any

import pytest

from cm.manager.access import register_service
from cm.manager.access.register_service import ReadPieces, WritePieces
from cm.wire.messages.requests import RegWrite
from cm.wire.messages.status import RegValue, RegValues

NAMES = tuple(f"r{number}" for number in range(200))


class Slow:
    """Registers of which each access takes some time."""

    def __init__(self, microseconds: int) -> None:
        self.now = 0
        self.pieces: list[int] = []
        self._each = microseconds * 1000

    def read(self, names: tuple[str, ...]) -> RegValues:
        self.pieces.append(len(names))
        self.now += len(names) * self._each
        return RegValues(tuple(RegValue(name, 1) for name in names))

    def checked(self, writes: tuple[RegWrite, ...], _: str) -> tuple[RegWrite, ...]:
        return writes

    def check_again(self, *_: object) -> None:
        """Do nothing: all registers still exist."""

    def write_checked(self, writes: tuple[RegWrite, ...]) -> RegValues:
        return self.read(tuple(write.name for write in writes))


def done(monkeypatch: pytest.MonkeyPatch, service: Slow, work: Any) -> list[int]:
    """The registers of each piece."""
    monkeypatch.setattr(register_service, "monotonic_ns", lambda: service.now)
    while not work.step():
        pass
    assert [value.name for value in work.result.values] == list(NAMES)
    return service.pieces


@pytest.mark.parametrize(("microseconds", "most"), [(1, 16), (20, 8), (1000, 1)])
def test_a_piece_has_fewer_registers_where_an_access_takes_long(
    monkeypatch: pytest.MonkeyPatch, microseconds: int, most: int
) -> None:
    for service in (Slow(microseconds), Slow(microseconds)):
        work: Any = ReadPieces(service, NAMES)  # type: ignore[arg-type]
        pieces = done(monkeypatch, service, work)
        assert max(pieces[5:]) == most
        assert sum(pieces) == len(NAMES)
    service = Slow(microseconds)
    work = WritePieces(service, tuple(RegWrite(name, 1) for name in NAMES), "")  # type: ignore[arg-type]
    assert max(done(monkeypatch, service, work)[5:]) == most


def test_pieces_grow_again_when_accesses_are_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    service = Slow(1000)
    work: Any = ReadPieces(service, NAMES)  # type: ignore[arg-type]
    monkeypatch.setattr(register_service, "monotonic_ns", lambda: service.now)
    for _ in range(6):
        work.step()
    service._each = 1
    assert done(monkeypatch, service, work)[:12] == [16, 8, 4, 2, 1, 1, 1, 2, 4, 8, 16, 16]

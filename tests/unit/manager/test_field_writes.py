# SPDX-License-Identifier: Apache-2.0
"""A write of one field leaves its neighbours as they are, or is refused: every pair of accesses, on bits as in RTL."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from types import MappingProxyType
from typing import Any
from unittest.mock import MagicMock

import pytest

from cm.client import register_window
from cm.client.errors import RequestFailed
from cm.errors import CmError
from cm.field_access import KINDS
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService
from cm.manager.errors import AccessDenied
from cm.manager.inputs import Window
from cm.manager.state.board_state import BoardState
from cm.manager.state.journal import ManagerState
from cm.schema.model import Access, BitField, Config, FieldAccess, Mode, Register
from cm.wire.messages.requests import RegWrite
from cm.wire.messages.status import ConfigInfo, FieldInfo, RegisterInfo

PLACES = ((0, 4), (4, 4))  # the first field of a pair, and the second
ACCESSES = ("rw", "wo", "w1c")  # of the register
PAIRS = list(product(ACCESSES, KINDS, KINDS))
ON_READ = {name: 15 if name.endswith("rs") else 0 for name, kind in KINDS.items() if kind.read_changes}
ON_WRITE = {
    **dict.fromkeys(("rw", "wo", "wrc", "wrs"), lambda held, bits: bits),
    **dict.fromkeys(("ro", "rc", "rs"), lambda held, bits: held),
    "wc": lambda held, bits: 0,
    "ws": lambda held, bits: 15,
    "w1c": lambda held, bits: held & ~bits,
    "w1s": lambda held, bits: held | bits,
    "w1t": lambda held, bits: held ^ bits,
    "w0c": lambda held, bits: held & bits,
    "w0s": lambda held, bits: held | ~bits & 15,
    "w0t": lambda held, bits: held ^ ~bits & 15,
}
ON_WRITE |= {name: ON_WRITE[name[:-2]] for name in KINDS if name not in ON_WRITE}  # w1src writes as w1s


class Rtl:
    """A register of two fields that does what a SystemRDL or UVM description says of it."""

    def __init__(self, first: str, second: str, held: int) -> None:
        self._does = (first, second)
        self.held = [held >> low & 15 for low, _ in PLACES]

    def read(self, *_: Any) -> int:
        shown = sum(
            held << low
            for (low, _), does, held in zip(PLACES, self._does, self.held, strict=True)
            if KINDS[does].readable
        )
        self.held = [ON_READ.get(does, held) for does, held in zip(self._does, self.held, strict=True)]
        return shown

    def write(self, value: int) -> None:
        pieces = zip(PLACES, self._does, self.held, strict=True)
        self.held = [ON_WRITE[does](held, value >> low & 15) for (low, _), does, held in pieces]


def register(access: str, first: str, second: str, reset: int | None = None) -> Register:
    fields = {
        name: BitField(name, *place, access=FieldAccess(does))
        for name, place, does in zip(("first", "second"), PLACES, (first, second), strict=True)
    }
    return Register("reg", 0, 0, 8, Access(access), reset=reset, fields=MappingProxyType(fields))


Write = Callable[[str, int], None]


def through_the_manager(spec: Register, rtl: Rtl, _: pytest.MonkeyPatch) -> Write:
    class Cells:
        """The devices of a board with this one register."""

        def window(self, address: int, width: int) -> Window:
            uio: Any = self
            return Window(uio, 0, address)

        def read(self, *_: int) -> int:
            return rtl.read()

        def write(self, offset: int, value: int, *_: int) -> None:
            rtl.write(value)

    config = Config("c", registers=MappingProxyType({"reg": spec}), modes=MappingProxyType({"m": Mode("m")}))
    journal: Any = MagicMock()
    state = ManagerState({"c": config}, journal)
    state.update(lambda _: BoardState("c", "m"))
    devices: Any = Cells()
    clock: Any = MagicMock()
    service = RegisterService(state, RegisterBus(devices), Leases(clock))
    return lambda name, value: service.write((RegWrite(name, value),), "") and None


def through_a_window(spec: Register, rtl: Rtl, patched: pytest.MonkeyPatch) -> Write:
    fields = (FieldInfo(f.name, f.lsb, f.width, access=spec.access_of(f).value) for f in spec.fields.values())
    info = RegisterInfo("reg", 0, 8, spec.access.value, fields=tuple(fields))
    patched.setattr(register_window, "read32", lambda *_: rtl.read())
    patched.setattr(register_window, "write_plain", lambda handle, offset, width, bits: rtl.write(bits) or 0)
    pages: Any = MagicMock(address=0, writable=True, module="m")
    window = object.__new__(register_window._compiled(pages, ConfigInfo(registers=(info,))))
    window._seen, window._handle = {}, None
    return window.__setitem__


@pytest.mark.parametrize("way", [through_the_manager, through_a_window])
@pytest.mark.parametrize("whole", [None, 0xA5], ids=["never written", "written once"])
def test_a_write_of_a_field_leaves_its_neighbour_or_is_refused(
    way: Callable[[Register, Rtl, pytest.MonkeyPatch], Write], whole: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = refused = 0
    for (access, first, second), held, value in product(PAIRS, (0x00, 0x5A), (0, 5, 15)):
        if access == "wo" and not (KINDS[first].writable and KINDS[second].writable):
            continue  # no schema may say so
        case = access, first, second, held, value
        rtl = Rtl(first, second, held)
        write = way(register(access, first, second), rtl, monkeypatch)
        if whole is not None:
            write("reg", whole)
        was = list(rtl.held)
        code = refusal(lambda write=write, value=value: write("reg.first", value))
        if code is None:
            done += 1
            assert rtl.held == [ON_WRITE[first](was[0], value), was[1]], case
        else:
            refused += 1
            assert (code, rtl.held) == ("access", was), case
            assert whole is None or not KINDS[first].writable or KINDS[second].idle == 3, case
    assert done > refused > 0


def refusal(write: Callable[[], None]) -> str | None:
    """The code of the error that a write raises."""
    try:
        write()
    except (AccessDenied, RequestFailed) as error:
        return error.code
    return None


@pytest.mark.parametrize("second", [name for name, kind in KINDS.items() if kind.idle == 2 and kind.read_changes])
def test_what_is_not_read_is_known_from_its_reset(second: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rtl = Rtl("rw", second, 0x70)
    through_the_manager(register("rw", "rw", second, 0x70), rtl, monkeypatch)("reg.first", 3)
    assert rtl.held == [3, 7]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        (
            ("w1s", "wrc"),
            "register 'reg' has a field that reading clears, and what second holds is not known: write the whole of it "
            "first, or say its reset in the schema",
        ),
        (("rw", "wc"), "'reg.first': any write of register 'reg' changes its field second: write the whole"),
    ],
)
def test_a_refusal_says_why_and_what_would_be_right(
    fields: tuple[str, str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = through_the_manager(register("rw", *fields), Rtl(*fields, 0), monkeypatch)
    with pytest.raises(CmError) as refused:
        write("reg.first", 1)
    assert str(refused.value) == said

# SPDX-License-Identifier: Apache-2.0
"""Registers by name, on cells instead of a board: which accesses are made, what is refused, and what is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceNotFound, DeviceTimeout
from cm.errors import CmError, InvalidRequest
from cm.manager.access.leases import Leases
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import ReadPieces, RegisterService, WritePieces
from cm.manager.errors import AccessDenied, HeldBy, NothingLoaded, OutOfRange, RegionBusy, UnknownRegister
from cm.manager.inputs import Window
from cm.manager.state.board_state import BoardState, RegionPhase, RegionState
from cm.manager.state.journal import ManagerState
from cm.schema import loads
from cm.schema.model import Access, Memory, Register
from cm.wire.messages.requests import RegWrite, TakeLease
from cm.wire.messages.status import RegValue, RegValues

CONFIG = loads("""
config:
  name: lab
  regions: {left: {}, right: {}}
  modules: {fir: {region: left}, iir: {region: left}, fft: {region: right}}
  mmio:
    - base_address: 0x1000
      registers:
        plain: {offset: 0x00}
        byte: {offset: 0x04, width: 8, min: 2, max: 9}
        ident: {offset: 0x08, access: ro, fields: {low: {bits: "3:0"}}}
        secret: {offset: 0x0c, access: wo}
        flags: {offset: 0x10, access: w1c}
        light:
          offset: 0x14
          max: 0x3f
          fields:
            on: {bits: 0}
            colour: {bits: "3:1", values: {off: 0, red: 4, rose: 5}}
            seen: {bits: 4, access: ro}
            begin: {bits: 5, access: w1s}
        loop: {offset: 0x18, reset: 0x80, fields: {go: {bits: 0}, done: {bits: 1, access: rc}}}
        door: {offset: 0x20, fields: {shut: {bits: 0}, key: {bits: "7:4", access: wo}}}
        fresh: {offset: 0x1c, fields: {go: {bits: 0}, done: {bits: 1, access: rc}}}
    - {base_address: 0x2000, region: left, registers: {gain: {offset: 0}}}
    - {base_address: 0x3000, region: right, registers: {depth: {offset: 0}}}
  modes:
    one: {modules: [fir]}
    two: {modules: [fir], registers: {lamp: {base_address: 0x1000, offset: 0x40}}}
    three: {modules: [iir], registers: {lamp: {base_address: 0x1000, offset: 0x40}}}
""")
CELLS = {0x1000: 0xA3, 0x1004: 5, 0x1008: 0x77, 0x1014: 0x1B, 0x2000: 7, 0x3000: 8, 0x1040: 6}

MAP = 3


class Cells:
    """A device that records its accesses, all of which are to one of its maps."""

    def __init__(self, cells: Mapping[int, int]) -> None:
        self.cells, self.done = dict(cells), list[tuple[str, int, int]]()
        self.missing = set[int]()

    def window(self, address: int, width: int) -> Window:
        if address in self.missing:
            raise DeviceNotFound(2, "nothing there")
        return Window(self, MAP, address)  # type: ignore[arg-type]

    def read(self, offset: int, width: int = 32, number: int = 0) -> int:
        assert number == MAP
        self.done.append(("read", offset, width))
        return self.cells.get(offset, 0)

    def read_block(self, offset: int, length: int, number: int = 0) -> bytearray:
        return bytearray(
            b"".join(self.read(at, 32, number).to_bytes(4, "little") for at in range(offset, offset + length, 4))
        )

    def write_block(self, offset: int, data: memoryview, number: int = 0) -> None:
        for at in range(0, len(data), 4):
            self.write(offset + at, int.from_bytes(data[at : at + 4], "little"), 32, number)

    def write(self, offset: int, value: int, width: int = 32, number: int = 0) -> None:
        assert number == MAP
        self.done.append(("write", offset, value))
        self.cells[offset] = value


class Bench:
    """A register service with one region ready, and the other cut off."""

    def __init__(self) -> None:
        self.cells: Any = Cells(CELLS)
        self.state = ManagerState({"lab": CONFIG}, None)  # type: ignore[arg-type]
        regions = {"left": RegionState(RegionPhase.READY, "fir"), "right": RegionState(RegionPhase.DECOUPLED)}
        self.state.update(lambda _: BoardState("lab", "one", regions=regions))
        self.leases = Leases(SimpleNamespace(monotonic=lambda: 0.0))
        self.service = RegisterService(self.state, RegisterBus(self.cells), self.leases)

    def enter(self, mode: str | None) -> None:
        self.state.update(lambda board: BoardState("lab", mode, regions=board.regions))

    def value(self, *names: str) -> list[int]:
        return [value.value for value in self.service.read(names).values]


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(
    ("write", "done", "told"),
    [
        (RegWrite("plain", 0xFFFFFFFF), [("write", 0x1000, 0xFFFFFFFF), ("read", 0x1000, 32)], 0xFFFFFFFF),
        (RegWrite("plain", 0x5F, mask=0xF),
         [("read", 0x1000, 32), ("write", 0x1000, 0xAF), ("read", 0x1000, 32)], 0xAF),
        (RegWrite("plain", 0, mask=0xF), [("read", 0x1000, 32), ("write", 0x1000, 0xA0), ("read", 0x1000, 32)], 0xA0),
        (RegWrite("plain", 0xFFFFFFFF, mask=0xF),
         [("read", 0x1000, 32), ("write", 0x1000, 0xAF), ("read", 0x1000, 32)], 0xAF),
        (RegWrite("byte", 9, mask=0xF), [("read", 0x1004, 8), ("write", 0x1004, 9), ("read", 0x1004, 8)], 9),
        (RegWrite("plain", 1, mask=0), [("read", 0x1000, 32), ("write", 0x1000, 0xA3), ("read", 0x1000, 32)], 0xA3),
        (RegWrite("plain", 9, mask=0xFFFFFFFF), [("write", 0x1000, 9), ("read", 0x1000, 32)], 9),
        (RegWrite("byte", 2), [("write", 0x1004, 2), ("read", 0x1004, 8)], 2),
        (RegWrite("byte", 9), [("write", 0x1004, 9), ("read", 0x1004, 8)], 9),
        (RegWrite("secret", 5), [("write", 0x100C, 5)], 5),
        (RegWrite("secret", 5, mask=0xF), [("write", 0x100C, 5)], 5),
        (RegWrite("light.colour", 0, named="red"),
         [("read", 0x1014, 32), ("write", 0x1014, 0x09), ("read", 0x1014, 32)], 0x09),
        (RegWrite("light.on", 0), [("read", 0x1014, 32), ("write", 0x1014, 0x0A), ("read", 0x1014, 32)], 0x0A),
        (RegWrite("light.begin", 1), [("read", 0x1014, 32), ("write", 0x1014, 0x2B), ("read", 0x1014, 32)], 0x2B),
        (RegWrite("loop.go", 1), [("write", 0x1018, 0x81)], 0x81),  # reading it would clear a field
        (RegWrite("fresh.go", 1), [("write", 0x101C, 1)], 1),
    ],
)  # fmt: skip
def test_a_write_touches_only_what_it_has_to(
    bench: Bench, write: RegWrite, done: list[tuple[str, int, int]], told: int
) -> None:
    result = bench.service.write((write,), "")
    name = write.name.partition(".")[0]
    assert (bench.cells.done, result[1:]) == (done, ("lab", "one", 1))
    assert (result.values[0].name, result.values[0].value) == (name, told)
    assert bench.state.written_value(name) == next(value for kind, _, value in done if kind == "write")
    assert bench.state.urgent is (name == "secret")


@pytest.mark.parametrize(
    ("access", "last", "done"),
    [
        (Access.WO, 0xB3, [("write", 16, 0x53)]),
        (Access.WO, None, [("write", 16, 0x50)]),
        (Access.W1C, 0xB3, [("write", 16, 0x50)]),
    ],
)
def test_other_bits_of_what_cannot_be_read_are_those_last_written_or_none(
    access: Access, last: int | None, done: list[tuple[str, int, int]]
) -> None:
    device: Any = Cells({16: 0xA3})
    register = Register("r", 16, 0, access=access)
    assert RegisterBus(device).write(register, 0x50, 0xF0, last) == done[-1][2]
    assert device.done == done
    if access is Access.WO:
        assert refused(lambda: RegisterBus(device).read(register)) == (AccessDenied, "register 'r' is write-only")


def test_a_block_is_moved_from_its_place_in_the_map_of_its_window() -> None:
    device: Any = Cells({})
    bus, memory = RegisterBus(device), Memory("block", 0x1000, 64, 0)
    bus.write_block(memory, 8, memoryview(b"abcdefgh"))
    assert (bus.read_block(memory, 12, 4), device.cells.keys()) == (b"efgh", {0x1008, 0x100C})


def test_what_was_written_before_is_kept_where_it_cannot_be_read(bench: Bench) -> None:
    for write in (
        RegWrite("secret", 0xB0),
        RegWrite("secret", 5, mask=0xF),
        RegWrite("loop", 6),
        RegWrite("loop.go", 1),
    ):
        bench.service.write((write,), "")
    assert [value for kind, _, value in bench.cells.done if kind == "write"] == [0xB0, 0xB5, 6, 5]


def refused(call: Callable[[], object]) -> tuple[type[Exception], str]:
    with pytest.raises(CmError) as caught:
        call()
    return caught.type, str(caught.value)


ONE_OF_BOTH = "is a field: give a value or a mask, not both"
OF_PLAIN, OF_BYTE = "outside 0 to 4294967295 (0x0 to 0xffffffff)", "outside 2 to 9 (0x2 to 0x9)"


@pytest.mark.parametrize(
    ("write", "error", "text"),
    [
        (RegWrite("plan", 1), UnknownRegister, "no register 'plan' in this mode; did you mean 'plain'?"),
        (RegWrite("lamp", 1), UnknownRegister, "no register 'lamp' in this mode (one); modes two, three have it"),
        (RegWrite("light.colon", 1), UnknownRegister, "register 'light' has no field 'colon'; did you mean 'colour'?"),
        (RegWrite("plain.on", 1), UnknownRegister, "register 'plain' has no field 'on'; there are none"),
        (RegWrite("ident", 1), AccessDenied, "register 'ident' is read-only"),
        (RegWrite("ident.low", 1), AccessDenied, "register 'ident' is read-only"),
        (RegWrite("light.seen", 1), AccessDenied, "field 'light.seen' is read-only"),
        (RegWrite("loop.done", 0), AccessDenied, "field 'loop.done' is read-only"),
        (RegWrite("light.on", 1, mask=1), InvalidRequest, f"'light.on' {ONE_OF_BOTH}"),
        (RegWrite("light.colour", 0, mask=1, named="red"), InvalidRequest, f"'light.colour' {ONE_OF_BOTH}"),
        (RegWrite("door.key", 16), OutOfRange, "register 'door.key': 16 (0x10) is outside 0 to 15 (0x0 to 0xf)"),
        (RegWrite("door.key", -1), OutOfRange, "register 'door.key': -1 (-0x1) is outside 0 to 15 (0x0 to 0xf)"),
        (
            RegWrite("light.colour", 0, named="read"),
            OutOfRange,
            "register 'light.colour' has no value 'read'; did you mean 'red'?",
        ),
        (
            RegWrite("plain", 0, named="red"),
            OutOfRange,
            "register 'plain' takes an integer, not 'red': its values have no names",
        ),
        (RegWrite("plain", 1 << 32), OutOfRange, f"register 'plain': 4294967296 (0x100000000) is {OF_PLAIN}"),
        (RegWrite("plain", -1), OutOfRange, f"register 'plain': -1 (-0x1) is {OF_PLAIN}"),
        (RegWrite("plain", -1, mask=1), OutOfRange, f"register 'plain': -1 (-0x1) is {OF_PLAIN}"),
        (RegWrite("plain", 1, mask=1 << 32), OutOfRange, "register 'plain': mask 0x100000000 does not fit 32 bits"),
        (RegWrite("plain", 1, mask=-1), OutOfRange, "register 'plain': mask -0x1 does not fit 32 bits"),
        (RegWrite("byte", 1), OutOfRange, f"register 'byte': 1 (0x1) is {OF_BYTE}"),
        (RegWrite("byte", 10), OutOfRange, f"register 'byte': 10 (0xa) is {OF_BYTE}"),
        (
            RegWrite("byte", 1, mask=0xFF),
            OutOfRange,
            f"register 'byte': 1 (0x1) is {OF_BYTE}",
        ),  # all bits, as without a mask
        (RegWrite("byte", 0, mask=0x0F), OutOfRange, f"register 'byte': 0 (0x0) is {OF_BYTE}"),
        (
            RegWrite("byte", 8, mask=8),
            OutOfRange,
            f"register 'byte': 13 (0xd) is {OF_BYTE}",
        ),  # with the bits that are there
        (RegWrite("light", 0x40), OutOfRange, "register 'light': 64 (0x40) is outside 0 to 63 (0x0 to 0x3f)"),
        (RegWrite("depth", 1), RegionBusy, "register 'depth' lies in region right, which is decoupled"),
    ],
)
def test_a_write_that_is_not_allowed_says_why_and_writes_nothing(
    bench: Bench, write: RegWrite, error: type[CmError], text: str
) -> None:
    assert refused(lambda: bench.service.write((write,), "")) == (error, text)
    assert not [kind for kind, _, _ in bench.cells.done if kind == "write"]
    if not write.mask:  # all are checked before the first is written, but for what the other bits hold
        assert refused(lambda: bench.service.write((RegWrite("secret", 1), write), "")) == (error, text)
        assert not bench.cells.done


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("plain", RegValue("plain", 0xA3)),
        ("ident", RegValue("ident", 0x77, (("low", 7),))),
        ("ident.low", RegValue("ident.low", 7)),
        ("light", RegValue("light", 0x1B, (("on", 1), ("colour", 5), ("seen", 1), ("begin", 0)))),
        ("light.colour", RegValue("light.colour", 5)),
        ("loop.done", RegValue("loop.done", 0)),
        ("secret", "register 'secret' is write-only"),
        ("door.key", "field door.key is write-only"),
        ("depth", "register 'depth' lies in region right, which is decoupled"),
        ("doar", "no register 'doar' in this mode; did you mean 'door'?"),
    ],
)
def test_a_name_is_read_or_refused_with_the_reason(bench: Bench, name: str, told: RegValue | str) -> None:
    if isinstance(told, RegValue):
        assert bench.service.read((name,)) == RegValues((told,), "lab", "one", 0)
        return
    assert refused(lambda: bench.service.read((name,)))[1] == told
    assert bench.cells.done == []


ALL = ["plain", "byte", "ident", "flags", "light", "door", "gain"]  # that reading does not change


def test_without_names_all_is_read_that_can_be_and_that_reading_does_not_change(bench: Bench) -> None:
    assert [value.name for value in bench.service.read(()).values] == ALL
    assert list(bench.service.readable_names()) == ALL
    assert {"secret", "loop", "depth"} <= set(bench.service.visible_names())
    bench.state.lock_regions(frozenset(), whole=True)
    assert bench.service.readable_names() == ()


def test_where_nothing_is_loaded_there_are_no_registers(bench: Bench) -> None:
    bench.state.update(lambda _: BoardState())
    assert refused(lambda: bench.service.read(("plain",))) == (
        NothingLoaded,
        "nothing is loaded, so there are no registers; there are lab",
    )
    assert list(bench.service.visible_names()) == []


def test_what_a_change_has_locked_is_refused_until_it_ends(bench: Bench) -> None:
    bench.state.lock_regions(frozenset({"left"}))
    assert bench.value("plain") == [0xA3]
    for access in (lambda: bench.value("gain"), lambda: bench.service.write((RegWrite("gain", 1),), "")):
        assert refused(access) == (
            RegionBusy,
            "register 'gain' lies in region left, which is being reconfigured",
        )
    bench.state.lock_regions(frozenset(), whole=True)
    assert refused(lambda: bench.value("plain")) == (
        RegionBusy,
        "register 'plain' lies in the static part, which is being reconfigured",
    )
    bench.state.release_regions()
    assert bench.value("plain", "gain") == [0xA3, 7]


@pytest.mark.parametrize(
    ("scope", "refused"),
    [
        ("registers:plain", True),
        ("region:left", True),
        ("board", True),
        ("registers:byte", False),
        ("region:right", False),
    ],
)
def test_only_the_holder_writes_what_a_lease_covers(bench: Bench, scope: str, refused: bool) -> None:
    lease = bench.leases.request(TakeLease(scope, holder="anna"), "")
    both = RegWrite("plain", 1), RegWrite("gain", 1)
    if refused:
        with pytest.raises(HeldBy, match=f"^{scope} is held by anna"):
            bench.service.write(both, "")
    assert len(bench.service.write(both, lease.id).values) == 2


def test_a_lookup_ends_with_its_mode_and_with_its_schema(bench: Bench) -> None:
    bench.enter("two")
    assert bench.value("lamp") == [6]
    bench.enter("one")
    with pytest.raises(UnknownRegister):
        bench.value("lamp")
    bench.enter("two")
    bench.state.add_config(loads("config: {name: lab, modes: {two: {}}, modules: {}}\n"))
    assert refused(lambda: bench.value("lamp")) == (UnknownRegister, "no register 'lamp' in this mode; there are none")


def test_registers_that_reading_leaves_alone_are_offered_with_their_fields(bench: Bench) -> None:
    table: Any = SimpleNamespace(told={})
    bench.cells.missing = {0x1010}
    table.offer = lambda name, device, place, bits: table.told.update({name: (place, bits)})
    bench.service.offer(("light", "ident", "loop", "secret", "depth", "flags", "door", "gain", "unknown"), table)
    everything = 0, (1 << 64) - 1
    assert table.told == {
        "light": ((MAP, 0x1014, 32), everything),
        "light.on": ((MAP, 0x1014, 32), (0, 1)),
        "light.colour": ((MAP, 0x1014, 32), (1, 14)),
        "light.seen": ((MAP, 0x1014, 32), (4, 16)),
        "light.begin": ((MAP, 0x1014, 32), (5, 32)),
        "ident": ((MAP, 0x1008, 32), everything),
        "ident.low": ((MAP, 0x1008, 32), (0, 15)),
        "door": ((MAP, 0x1020, 32), everything),
        "door.shut": ((MAP, 0x1020, 32), (0, 1)),
        "gain": ((MAP, 0x2000, 32), everything),  # though the device of `flags` is not there
    }

    def hangs(*_: object) -> None:
        raise DeviceTimeout(110, "the table is in use")

    table.offer = hangs
    with pytest.raises(DeviceTimeout):
        bench.service.offer(("gain",), table)


def test_a_long_read_of_everything_leaves_out_what_has_gone_and_one_by_name_does_not(bench: Bench) -> None:
    everything, named = ReadPieces(bench.service, ()), ReadPieces(bench.service, ("gain",))
    bench.state.lock_regions(frozenset({"left"}))
    assert everything.step()
    assert [value.name for value in everything.newest] == [name for name in ALL if name != "gain"]
    assert everything.result == RegValues(everything.newest, "lab", "one", 0)
    with pytest.raises(RegionBusy):
        named.step()


def test_a_long_write_is_checked_again_before_each_piece(bench: Bench) -> None:
    def begun() -> WritePieces:
        made = WritePieces(bench.service, tuple(RegWrite("gain", number) for number in range(17)), "")
        assert not made.step()
        return made

    going, moved, leased = begun(), begun(), begun()
    assert going.step()
    assert (going.newest, going.result.generation) == ((RegValue("gain", 16),), 4)
    assert [value.value for value in going.result.values] == list(range(17))
    bench.leases.request(TakeLease("registers:gain", holder="anna"), "")
    with pytest.raises(HeldBy):
        leased.step()
    bench.state.add_config(loads("config: {name: lab, modes: {one: {}}}\n"))
    assert refused(moved.step) == (
        RegionBusy,
        "register 'gain': the mode was changed while the request was carried out",
    )
    assert (moved.newest, bench.cells.cells[0x2000]) == ((), 16)

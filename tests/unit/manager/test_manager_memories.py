# SPDX-License-Identifier: Apache-2.0
"""Memories in the manager: rights, addresses, long transfers, changes of mode, devices that fail."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from manager_support import Rig, rig

from cm.device import DeviceError, DeviceNotFound
from cm.errors import CmError, InvalidRequest
from cm.manager.access.memory_service import LENGTH_MAX, PIECE, Transfer
from cm.manager.errors import AccessDenied, HeldBy, NothingLoaded, OutOfRange, RegionBusy, UnknownMemory
from cm.schema import load
from cm.schema.model import ITEM_BYTES, Access, Config
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, DefineMemory, TakeLease
from cm.wire.messages.status import MemoryInfo

SCHEMA = """
config:
  name: filter
  regions:
    left:
      decoupler: {base_address: 0x1000, offset: 0, bit: 0}
      identity: {base_address: 0x20000, offset: 0x10}
    right: {decoupler: {base_address: 0x1000, offset: 0, bit: 1}}
  modules:
    fir:
      region: left
      identity: 1
      mmio:
        - base_address: 0x20000
          registers: {gain: {offset: 0}}
          memories:
            taps: {offset: 0x1000, size: 0x1000, dtype: int16, shape: [32, 64]}
            key: {offset: 0x2000, size: 64, access: wo}
    iir: {region: left, identity: 2}
    fft: {region: right, mmio: [{base_address: 0x40000, memories: {twiddle: {size: 256}}}]}
  mmio:
    - base_address: 0x1000
      registers: {led: {offset: 0x10}, tiny: {offset: 0x20, width: 8}}
      memories: {scratch: {offset: 0x800, size: 0x400}}
  memories:
    big: {base_address: 0x10000000, size: 0x800000}
    log: {base_address: 0x60000, size: 64, access: ro}
  streams: {samples: {direction: s2mm, region: left, shape: [4]}}
  modes:
    default: {modules: [fir]}
    other: {modules: [iir]}
    both: {modules: [fir, fft], registers: {mine: {base_address: 0x60000, offset: 0x80}}}
"""
PLAIN = (
    "config: {name: plain, regions: [left, right], modules: {fir: {region: left}}, modes: {default: {modules: [fir]}}}"
)


@pytest.fixture(scope="module")
def configs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Config]:
    folder = tmp_path_factory.mktemp("schemas")
    for name, text in (("filter", SCHEMA), ("plain", PLAIN)):
        (folder / f"{name}.yaml").write_text(text)
    return {name: load(folder / f"{name}.yaml") for name in ("filter", "plain")}


@pytest.fixture(scope="module")
def sim(configs: dict[str, Config]) -> Iterator[SimBoard]:
    with SimBoard([config.source for config in configs.values()], arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def fresh(sim: SimBoard, tmp_path: Path, configs: dict[str, Config]) -> Iterator[Rig]:
    with rig(sim.root, tmp_path, *configs.values()) as started:
        yield started
        sim.control.clear()


@pytest.fixture
def made(fresh: Rig) -> Rig:
    assert fresh.go("default", config="filter") is None
    return fresh


def moved(transfer: Transfer) -> bytes:
    """Do a whole transfer at once."""
    while not transfer.step():
        pass
    return bytes(transfer.data)


def read(made: Rig, name: str, offset: int = 0, length: int = 0) -> bytes:
    return moved(made.manager.memories.begin_read(name, offset, length))


def write(made: Rig, name: str, data: bytes, offset: int = 0, lease: str = "") -> None:
    moved(made.manager.memories.begin_write(name, offset, data, lease))


def define(made: Rig, name: str, address: int, length: int, **more: object) -> None:
    made.manager.memories.define(DefineMemory(name, address=address, length=length, **more))  # type: ignore[arg-type]


def test_what_was_written_is_read(made: Rig) -> None:
    data = np.random.default_rng(1).integers(0, 256, 0x1000, np.uint8).tobytes()
    write(made, "taps", data)
    assert read(made, "taps") == data
    write(made, "taps", b"12345678", 0xFF8)
    assert read(made, "taps", 0xFF4) == data[0xFF4:0xFF8] + b"12345678"
    assert read(made, "taps", 0xFF0, 8) == data[0xFF0:0xFF8]


def test_a_long_transfer_goes_piece_by_piece(made: Rig) -> None:
    data = np.random.default_rng(2).integers(0, 256, LENGTH_MAX, np.uint8).tobytes()
    before = read(made, "big", 0, 0x100)
    writing = made.manager.memories.begin_write("big", 0x100, data, "")
    steps = 1
    while not writing.step():
        steps += 1
    assert steps == LENGTH_MAX // PIECE
    assert read(made, "big", 0x100, LENGTH_MAX) == data
    assert read(made, "big", 0, 0x100) == before


@pytest.mark.parametrize(
    ("name", "offset", "length", "form"),
    [
        ("taps", 0, 0, ((32, 64), "int16")),
        ("taps", 4, 8, ((4,), "int16")),
        ("taps", 0xFFC, 4, ((2,), "int16")),
        ("pairs", 8, 16, ((16,), "uint8")),  # not of whole elements
        ("pairs", 16, 8, ((8,), "uint8")),
        ("pairs", 16, 32, ((2,), "complex128")),
        ("pairs", 0, 0, ((4,), "complex128")),
    ],
)
def test_the_form_of_what_is_read_is_that_of_the_schema_if_it_can_be(
    made: Rig, name: str, offset: int, length: int, form: tuple[tuple[int, ...], str]
) -> None:
    define(made, "pairs", 0x60100, 64, dtype="complex128")
    begun = made.manager.memories.begin_read(name, offset, length)
    assert (begun.form, begun.data) == (form, b"")  # nothing was read yet


def refused(call: Callable[[], object]) -> tuple[type[Exception], str]:
    with pytest.raises(CmError) as caught:
        call()
    return caught.type, str(caught.value)


WORDS = "are not whole words: multiples of 4 are"
THERE = "it has 4096, and one word is the least"
PARTS = "in one request; 4194304 is the most, ask for parts by offset"


@pytest.mark.parametrize(
    ("name", "offset", "length", "error", "text"),
    [
        ("taps", 2, 4, InvalidRequest, f"memory 'taps': 4 bytes at offset 2 {WORDS}"),
        ("taps", 0, 6, InvalidRequest, f"memory 'taps': 6 bytes at offset 0 {WORDS}"),
        ("taps", 0xFFC, 8, OutOfRange, f"memory 'taps': 8 bytes at offset 4092; {THERE}"),
        ("taps", 0x1000, 0, OutOfRange, f"memory 'taps': 0 bytes at offset 4096; {THERE}"),
        ("taps", 1 << 63, 4, OutOfRange, f"memory 'taps': 4 bytes at offset {1 << 63}; {THERE}"),
        ("big", 0, LENGTH_MAX + 4, OutOfRange, f"memory 'big': 4194308 bytes {PARTS}"),
        ("big", 0, 0, OutOfRange, f"memory 'big': 8388608 bytes {PARTS}"),
        ("key", 0, 4, AccessDenied, "memory 'key' is write-only"),
        ("tabs", 0, 4, UnknownMemory, "no memory 'tabs'; did you mean 'taps'?"),
        ("TAPS", 0, 4, UnknownMemory, "no memory 'TAPS'; did you mean 'taps'?"),
        ("twiddle", 0, 4, UnknownMemory, "no memory 'twiddle' in this mode (default); modes both have it"),
    ],
)
def test_an_impossible_read_of_a_memory_is_refused(
    made: Rig, name: str, offset: int, length: int, error: type[CmError], text: str
) -> None:
    assert refused(lambda: made.manager.memories.begin_read(name, offset, length)) == (error, text)


@pytest.mark.parametrize(
    ("name", "offset", "data", "error", "text"),
    [
        ("log", 0, b"1234", AccessDenied, "memory 'log' is read-only"),
        ("taps", 0, b"", OutOfRange, f"memory 'taps': 0 bytes at offset 0; {THERE}"),
        ("taps", 0, b"123", InvalidRequest, f"memory 'taps': 3 bytes at offset 0 {WORDS}"),
        ("taps", 0xFFC, b"12345678", OutOfRange, f"memory 'taps': 8 bytes at offset 4092; {THERE}"),
    ],
)
def test_an_impossible_write_to_a_memory_is_refused(
    made: Rig, name: str, offset: int, data: bytes, error: type[CmError], text: str
) -> None:
    assert refused(lambda: made.manager.memories.begin_write(name, offset, data, "")) == (error, text)


def test_nothing_loaded_has_no_memories(fresh: Rig) -> None:
    nothing = NothingLoaded, "nothing is loaded, so there are no memories"
    assert refused(lambda: read(fresh, "taps")) == nothing
    assert refused(lambda: define(fresh, "block", 0x60100, 4)) == nothing
    assert (fresh.manager.memories.find("taps"), fresh.manager.memories.listed()) == (None, "")


def test_a_change_takes_the_memories_of_its_regions_and_leaves_the_others(made: Rig, sim: SimBoard) -> None:
    write(made, "taps", b"kept")
    seen: dict[str, object] = {}

    def look(name: str) -> None:
        if name == "icap.wait":
            seen["static"] = read(made, "scratch", 0, 4)
            try:
                read(made, "taps", 0, 4)
            except CmError as error:
                seen["left"] = error

    write(made, "scratch", b"here")
    made.fault.watch = look
    assert made.go("both", config="filter") is None  # fir is there already: only right is loaded
    assert seen == {"static": b"here"}
    change = made.manager.submit(ChangeMode(config_name="filter", mode="default", force=True))
    assert change.wait(60)
    assert change.error is None
    made.fault.watch = lambda name: None
    assert isinstance(seen["left"], RegionBusy)
    assert "being reconfigured" in str(seen["left"])
    assert read(made, "taps", 0, 4) == bytes(4)  # as the bitstream has it


def test_the_rest_of_a_transfer_is_refused_when_its_region_was_changed_meanwhile(made: Rig) -> None:
    reading = made.manager.memories.begin_read("taps", 0, 0)
    assert made.go("other", config="filter") is None
    with pytest.raises(UnknownMemory, match="modes default, both have it"):
        reading.step()
    assert made.go("default", config="filter") is None
    assert refused(reading.step) == (
        RegionBusy,
        "memory 'taps': region left was changed meanwhile; 0 of 4096 bytes had been moved",
    )
    define(made, "block", 0x60100, 64)
    moving = made.manager.memories.begin_read("block", 0, 0)
    define(made, "block", 0x60200, 64)
    assert refused(moving.step) == (UnknownMemory, "memory 'block' is another one now, in mode 'default'")
    assert read(made, "taps") == bytes(0x1000)


def test_a_change_that_fails_does_not_bring_the_content_back(made: Rig, sim: SimBoard) -> None:
    write(made, "taps", b"lost")
    write(made, "scratch", b"kept")
    sim.control.inject("icap_crc")
    assert made.go("other", config="filter") is not None
    assert made.manager.state.mode == "default"
    assert read(made, "taps", 0, 4) == bytes(4)
    assert read(made, "scratch", 0, 4) == b"kept"


def test_a_uio_device_that_fails_ends_the_transfer_and_nothing_else(made: Rig) -> None:
    write(made, "big", bytes(4 * PIECE))
    reading = made.manager.memories.begin_read("big", 0, 4 * PIECE)
    assert not reading.step()
    made.arm(0)
    with pytest.raises(DeviceError, match=r"injected at uio\.read_block"):
        reading.step()
    made.arm(-1)
    assert moved(reading) == bytes(4 * PIECE)  # who asks again gets the rest
    writing = made.manager.memories.begin_write("big", 0, b"\1" * 2 * PIECE, "")
    assert not writing.step()
    made.arm(0)
    with pytest.raises(DeviceError, match=r"injected at uio\.write_block"):
        writing.step()
    made.arm(-1)
    assert read(made, "big", 0, 2 * PIECE) == b"\1" * PIECE + bytes(PIECE)  # part is written


def test_a_memory_whose_window_is_not_there_is_not_found(fresh: Rig, sim: SimBoard, configs: dict[str, Config]) -> None:
    config = configs["filter"]
    gone = replace(config.memories["log"], base_address=0x7000_0000)
    fresh.manager.add_config(replace(config, memories={**config.memories, "log": gone}))
    assert fresh.go("default", config="filter") is None
    with pytest.raises(DeviceNotFound, match="no UIO device covers 0x70000000"):
        read(fresh, "log")


@pytest.mark.parametrize("scope", ["memories:taps", "region:left", "config", "board"])
def test_only_the_holder_of_its_lease_writes_a_memory(made: Rig, scope: str) -> None:
    for other in ("memories:key", "region:right", "registers:gain") if ":" in scope else ():
        made.manager.leases.request(TakeLease(other))  # which keeps nobody off
    lease = made.manager.leases.request(TakeLease(scope, holder="anna")).id
    with pytest.raises(HeldBy, match="anna"):
        write(made, "taps", b"1234")
    write(made, "taps", b"5678", lease=lease)
    assert read(made, "taps", 0, 4) == b"5678"


def test_a_change_is_refused_for_a_lease_on_a_memory_that_it_would_lose(made: Rig) -> None:
    made.manager.leases.request(TakeLease("memories:taps", holder="anna"))
    with pytest.raises(HeldBy, match="anna"):
        made.go("both", config="filter")
    assert made.go("other", config="filter") is None  # taps is not part of it


# ---- blocks that the schema does not name ------------------------------------------------


def test_a_block_lasts_until_another_configuration_is_loaded(made: Rig) -> None:
    define(made, "block", 0x60100, 64)
    write(made, "block", b"1234")
    assert made.go("other", config="filter") is None
    assert read(made, "block", 0, 4) == b"1234"
    assert made.go("default", config="plain") is None
    assert made.go("default", config="filter") is None
    assert made.manager.memories.find("block") is None
    with pytest.raises(UnknownMemory, match="block"):
        read(made, "block")


def test_a_block_is_forgotten_with_a_schema_that_takes_its_place_and_with_the_board(
    made: Rig, configs: dict[str, Config]
) -> None:
    define(made, "block", 0x60100, 64)
    made.manager.add_config(configs["plain"])
    assert made.manager.memories.find("block")
    made.manager.add_config(configs["filter"])
    assert made.manager.memories.find("block") is None
    define(made, "block", 0x60100, 64)
    before = made.devices.uio("uio0")
    made.manager.board_restarted()
    assert not made.manager.memories.defined()
    assert made.devices.uio("uio0") is not before


def test_a_block_may_be_defined_anew(made: Rig) -> None:
    define(made, "block", 0x60100, 64, access="ro")
    define(made, "block", 0x60200, 128, dtype="uint8", shape=(2, 64))
    memory = made.manager.memories.named("block")
    assert (memory.address, memory.size, memory.access, memory.shape) == (0x60200, 128, Access.RW, (2, 64))
    assert [info.defined for info in made.manager.memories.defined()] == [True]


@pytest.mark.parametrize(
    ("address", "length", "region"),
    [
        (0x21000, 64, "left"),  # over taps
        (0x20100, 64, "left"),  # beside the registers of left
        (0x40000, 64, "right"),
        (0x40200, 64, "right"),  # beside what begins with its window
        (0x60040, 64, None),
    ],
)
def test_a_block_is_in_the_region_of_what_has_a_name_there(
    made: Rig, address: int, length: int, region: str | None
) -> None:
    define(made, "block", address, length, access="ro")
    assert made.manager.memories.named("block").region == region


COVERED = "which has rights and limits of its own: take another place, or access ro"


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"address": 0x60100}, "length is missing; address and length, in bytes, define a memory"),
        ({"length": 64}, "address is missing; address and length, in bytes, define a memory"),
        ({"address": 0x60102, "length": 64}, f"64 bytes at 0x60102 {WORDS}"),
        ({"address": 0x60100, "length": 6}, f"6 bytes at 0x60100 {WORDS}"),
        ({"address": (1 << 64) - 4, "length": 8}, "it ends behind the last address of 64 bits"),
        ({"address": 0x60100, "length": 64, "access": "w1c"}, "access 'w1c'; it is one of rw, ro, wo"),
        ({"address": 0x60100, "length": 64, "dtype": "int3"}, f"no dtype 'int3'; there are {', '.join(ITEM_BYTES)}"),
        ({"address": 0x60100, "length": 12, "dtype": "float64"}, "its 12 bytes are not whole elements of float64"),
        ({"address": 0x60100, "length": 64, "shape": (4, 5)}, "its 64 bytes are not shape [4, 5] of uint32"),
        ({"address": 0x60100, "length": 4, "region": "mid"}, "there is no region 'mid'; there are left, right, static"),
    ],
)
def test_an_impossible_block_is_refused(made: Rig, given: dict[str, Any], text: str) -> None:
    define = made.manager.memories.define
    assert refused(lambda: define(DefineMemory("block", **given))) == (InvalidRequest, f"memory 'block': {text}")
    assert not made.manager.memories.defined()


@pytest.mark.parametrize(
    ("address", "length", "what"),
    [
        (0x1000, 16, "the decoupler of region 'left' at 0x1000"),
        (0x1010, 4, "register 'led' at 0x1010"),
        (0x1008, 12, "register 'led' at 0x1010"),
        (0x1020, 4, "register 'tiny' at 0x1020"),
        (0x20010, 4, "the identity of region 'left' at 0x20010"),
        (0x1BFC, 8, "memory 'scratch' at 0x1800"),
        (0x1C00, 4, ""),
        (0x100C, 4, ""),
        (0x1014, 4, ""),
    ],
)
def test_a_writable_block_covers_nothing_that_has_a_name(made: Rig, address: int, length: int, what: str) -> None:
    def wanted() -> None:
        define(made, "block", address, length, access="wo")

    if what:
        assert refused(wanted) == (InvalidRequest, f"memory 'block' covers {what}, {COVERED}")
    else:
        wanted()
    define(made, "block", address, length, access="ro")


@pytest.mark.parametrize(("address", "length", "words"), [(0x7000_0000, 64, "windows in"), (0x60FFC, 8, "0x60ffc")])
def test_a_block_outside_all_windows_is_not_found(made: Rig, address: int, length: int, words: str) -> None:
    with pytest.raises(DeviceNotFound, match=words):
        define(made, "block", address, length)


FORM = "letters, digits, _ and - make a name, at most 64, no digit first"
TAKEN = "of configuration 'filter': give another name"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("taps", f"'taps' is a memory {TAKEN}"),
        ("twiddle", f"'twiddle' is a memory {TAKEN}"),
        ("samples", f"'samples' is a stream {TAKEN}"),
        ("a.b", f"memory 'a.b': {FORM}"),
        ("", f"memory '': {FORM}"),
        ("7up", f"memory '7up': {FORM}"),
        ("x" * 99, f"memory '{'x' * 80}': {FORM}"),
        ("x" * 64, ""),
        ("_a-7", ""),
    ],
)
def test_a_name_that_is_taken_or_invalid_is_refused(made: Rig, name: str, text: str) -> None:
    if text:
        assert refused(lambda: define(made, name, 0x60100, 64)) == (InvalidRequest, text)
        return
    define(made, name, 0x60100, 64)
    assert made.manager.memories.info(made.manager.memories.named(name)) == MemoryInfo(
        name, 0x60100, 64, defined=True, region=""
    )
    assert made.manager.memories.listed() == f"; memories are {', '.join(sorted([*IN_DEFAULT, name]))}"


IN_DEFAULT = ("big", "key", "log", "scratch", "taps")


def test_a_memory_is_not_configured_as_a_stream(made: Rig) -> None:
    made.manager.memories.check_no_memory("samples")
    assert refused(lambda: made.manager.memories.check_no_memory("taps")) == (
        InvalidRequest,
        "memory 'taps' is not a stream: only one that was defined at run time can be defined again, with address and "
        "length",
    )


def test_two_blocks_do_not_share_a_place_unless_they_are_read(made: Rig) -> None:
    define(made, "one", 0x60100, 64)
    with pytest.raises(InvalidRequest, match="covers memory 'one'"):
        define(made, "two", 0x60120, 64)
    define(made, "two", 0x60120, 64, access="ro")
    write(made, "one", bytes(0x20) + b"seen")
    assert read(made, "two", 0, 4) == b"seen"


def test_a_block_is_not_written_in_a_mode_that_has_something_in_its_place(made: Rig) -> None:
    define(made, "block", 0x60080, 4)
    write(made, "block", b"1234")
    assert made.go("both", config="filter") is None
    with pytest.raises(InvalidRequest, match="covers register 'mine'"):
        write(made, "block", b"5678")
    assert read(made, "block") == b"1234"


def test_a_region_that_is_not_clear_has_to_be_said(fresh: Rig, configs: dict[str, Config], sim: SimBoard) -> None:
    config = configs["filter"]
    there = replace(config.registers["led"], name="lr", region="right", offset=0x40)
    fresh.manager.add_config(replace(config, registers={**config.registers, "lr": there}))
    assert fresh.go("default", config="filter") is None
    assert refused(lambda: define(fresh, "block", 0x1100, 64)) == (
        InvalidRequest,
        "memory 'block': region is missing; its window has registers of right, static",
    )
    define(fresh, "block", 0x1100, 64, region="static")
    assert fresh.manager.memories.named("block").region is None


def test_the_holder_of_a_region_defines_its_blocks(made: Rig) -> None:
    lease = made.manager.leases.request(TakeLease("region:left", holder="anna")).id
    with pytest.raises(HeldBy, match="anna"):
        define(made, "block", 0x20100, 64)
    define(made, "block", 0x20100, 64, lease=lease)


places = st.sampled_from([0x1000, 0x20000, 0x40000, 0x60000, 0x10000000])


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    address=st.builds(lambda base, more: base + more, places, st.integers(-16, 0x4000)),
    length=st.integers(0, 0x5000),
    access=st.sampled_from(["", "rw", "ro", "wo"]),
    dtype=st.sampled_from(["", "uint8", "int16", "float64"]),
    shape=st.lists(st.integers(1, 64), max_size=2).map(tuple),
)
def test_a_definition_is_refused_or_is_a_memory_that_can_be_used(
    made: Rig, address: int, length: int, access: str, dtype: str, shape: tuple[int, ...]
) -> None:
    memories, config = made.manager.memories, made.manager.loaded_config()
    assert config is not None
    try:
        memory = memories.define(
            DefineMemory("block", address, length=length, shape=shape, dtype=dtype, access=access, region="static")
        )
    except (InvalidRequest, DeviceNotFound):
        return
    assert (memory.address, memory.size) == (address, length)
    assert address % 4 == length % 4 == 0
    assert length == math.prod(memory.shape or (length // memory.item,)) * memory.item
    for register in config.visible_registers("default").values():
        assert memory.access is Access.RO or register.address >= memory.end or register.address + 4 <= memory.address
    if memory.access is not Access.WO:
        assert len(read(made, "block", 0, min(length, PIECE))) == min(length, PIECE)


words = st.integers(0, 0x440).map(lambda number: 4 * number)
accesses = st.lists(st.tuples(st.booleans(), words, words, st.integers(0, 255)), max_size=12)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(accesses)
def test_a_memory_is_as_an_array_of_bytes_or_refuses(made: Rig, steps: list[tuple[bool, int, int, int]]) -> None:
    model = bytearray(0x1000)
    write(made, "taps", bytes(model))
    for writes, offset, length, value in steps:
        inside = offset + length <= len(model)
        if writes and inside and length:
            write(made, "taps", bytes([value]) * length, offset)
            model[offset : offset + length] = bytes([value]) * length
        elif writes:
            with pytest.raises(OutOfRange):
                write(made, "taps", bytes([value]) * length, offset)
        elif inside and offset < len(model):
            assert read(made, "taps", offset, length) == (model[offset : offset + length] or model[offset:])
        else:
            with pytest.raises(OutOfRange):
                read(made, "taps", offset, length)
    assert read(made, "taps") == model

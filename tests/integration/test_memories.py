# SPDX-License-Identifier: Apache-2.0
"""Memories as arrays of a client and on the command line; what the manager makes of them is in tests/unit/manager."""

from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import Manager, served, until

import cm
from cm.cli.main import main
from cm.client import aio
from cm.client.errors import RequestBusy, RequestFailed, RequestNotFound
from cm.errors import InvalidRequest
from cm.simulation.software import Board as SimBoard

SCHEMA = """
config:
  name: filter
  regions: {left: {decoupler: {base_address: 0x1000, offset: 0, bit: 0}, timeout: 60}}
  modules:
    fir:
      region: left
      mmio:
        - base_address: 0x20000
          registers: {gain: {offset: 0}}
          memories: {taps: {offset: 0x1000, size: 0x1000, dtype: int16, shape: [32, 64], doc: Coefficients.}}
    iir: {region: left}
  mmio:
    - base_address: 0x1000
      registers: {led: {offset: 0x10}}
      memories: {scratch: {offset: 0x800, size: 0x400, dtype: uint8}}
  memories:
    big: {base_address: 0x10000000, size: 0xA00000}
    floats: {base_address: 0x60000, size: 64, dtype: float32}
    log: {base_address: 0x60000, offset: 0x40, size: 64, access: ro}
  streams: {samples: {direction: s2mm, region: left, shape: [4]}}
  modes:
    default: {modules: [fir]}
    other: {modules: [iir]}
"""
OTHER = """
config:
  name: plain
  regions: [left]
  modules: {iir: {region: left}}
  memories: {samples: {base_address: 0x60000, offset: 0x200, size: 16}}
  modes: {default: {modules: [iir]}}
"""
MIB = 1 << 20


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Manager, SimBoard]]:
    folder = tmp_path_factory.mktemp("schemas")
    (folder / "filter.yaml").write_text(SCHEMA)
    (folder / "plain.yaml").write_text(OTHER)
    with served(schemas=folder) as running:
        yield running


@pytest.fixture
def manager(both: tuple[Manager, SimBoard]) -> Manager:
    return both[0]


@pytest.fixture
def board(manager: Manager) -> Iterator[cm.Board]:
    with manager.connected() as connected:
        connected.load("filter", "default")
        yield connected


def noise(length: int, dtype: str = "uint8") -> np.ndarray[Any, Any]:
    return np.random.default_rng(length).integers(0, 256, length, np.uint8).view(dtype)


def test_a_written_array_is_read_back_with_its_shape_and_dtype(board: cm.Board) -> None:
    taps = board.memories["taps"]
    values = noise(0x1000, "int16").reshape(32, 64)
    assert taps.write(values) == 0x1000
    found = taps.read()
    assert (found.shape, found.dtype) == ((32, 64), np.int16)
    assert np.array_equal(found, values)
    found[0] = 0  # it belongs to the caller
    assert np.array_equal(np.asarray(taps), values)


def test_a_memory_longer_than_one_message_is_moved_in_several(board: cm.Board) -> None:
    big = board.memories["big"]
    values = noise(10 * MIB, "uint32")
    big.write(values)
    assert np.array_equal(big.read(), values)
    assert np.array_equal(big.read(4, 9 * MIB), values[1 : 1 + 9 * MIB // 4])
    with pytest.raises(InvalidRequest, match="it has 10485760"):
        big.read(4, 10 * MIB)


def test_registers_are_read_while_a_long_transfer_goes_on(manager: Manager, board: cm.Board) -> None:
    async def run() -> int:
        async with aio.connect(runtime_dir=manager.runtime, timeout=60) as peer:
            reading = asyncio.ensure_future(peer.memories["big"].read(0, 4 * MIB))
            reads = 0
            while not reading.done():
                await peer.registers.read("gain")
                reads += 1
            assert len(await reading) == MIB
            return reads

    # If the client itself is slow, the transfer may be over before its second read, but not each time.
    until(lambda: asyncio.run(run()) > 1)


def test_memories_can_be_listed(board: cm.Board) -> None:
    assert sorted(board.memories) == ["big", "floats", "log", "scratch", "taps"]
    info = board.memories.info["taps"]
    assert (info.address, info.size, info.dtype, info.shape, info.access) == (0x21000, 0x1000, "int16", (32, 64), "rw")
    assert (info.region, info.doc, info.modes, info.defined) == ("left", "Coefficients.", ("default",), False)
    assert board.memories["taps"].info.region == "left"
    board.mode = "other"
    assert "taps" not in board.memories
    assert "taps" in {memory.name for memory in board.config("filter").memories}


@pytest.mark.parametrize(
    ("use", "kind", "code", "words"),
    [
        (lambda b: b.memories["tabs"].read(), RequestNotFound, "unknown_stream", "memories are big, floats"),
        (lambda b: b.memories["samples"].read(), InvalidRequest, "invalid_request", "is a stream"),
        (lambda b: b.memories["taps"].read(-4, 4), InvalidRequest, "invalid_request", "offset=-4 is out of its range"),
        (lambda b: b.configure_memory("x", 0x7000, 64), RequestFailed, "device_not_found", "windows in"),
    ],
)
def test_what_is_wrong_gets_a_clear_error(board: cm.Board, use: Any, kind: type, code: str, words: str) -> None:
    with pytest.raises(kind, match=words) as refused:
        use(board)
    assert refused.value.code == code


def test_a_channel_of_the_board_that_is_called_as_a_memory_is_no_stream(board: cm.Board) -> None:
    assert {stream.name for stream in board.status.streams} == {"samples"}
    board.load("plain")  # names no streams, so the board's channels are streams, except that one
    assert {stream.name for stream in board.status.streams} == {"camera", "to_pl", "from_pl"}
    board.memories["samples"].write([1, 2, 3, 4])
    assert board.memories["samples"].read().tolist() == [1, 2, 3, 4]


def test_transfers_beyond_the_limit_are_asked_to_try_again(manager: Manager, board: cm.Board) -> None:
    async def run() -> list[Any]:
        async with aio.connect(runtime_dir=manager.runtime, timeout=60) as peer:
            reads = [peer.memories["big"].read(0, 4 * MIB) for _ in range(80)]
            return await asyncio.gather(*reads, return_exceptions=True)

    refused: list[Any] = []
    while not refused:  # a slow client may ask for the last of them when the first have been served
        found = asyncio.run(run())
        refused = [one for one in found if isinstance(one, Exception)]
    assert {type(one) for one in refused} == {RequestBusy}
    assert any("64 requests of" in str(one) for one in refused)
    assert all(len(one) == MIB for one in found if not isinstance(one, Exception))


# ---- the command ---------------------------------------------------------------------------


class Command:
    """`cm mem`, in this process."""

    def __init__(self, manager: Manager, capture: pytest.CaptureFixture[bytes]) -> None:
        self._manager, self._capture = manager, capture
        self.err = b""

    def __call__(self, *arguments: str) -> bytes:
        """What it prints; it must end well."""
        status, out = self.ended(*arguments)
        assert status == 0, self.err
        return out

    def ended(self, *arguments: str) -> tuple[int, bytes]:
        """Its exit status and its output."""
        self._capture.readouterr()
        try:
            status = main(["mem", *arguments, "--runtime-dir", str(self._manager.runtime)])
        except SystemExit as end:
            status = int(end.code or 0)
        out, self.err = self._capture.readouterr()
        return status, out


@pytest.fixture
def mem(manager: Manager, board: cm.Board, capsysbinary: pytest.CaptureFixture[bytes]) -> Command:
    return Command(manager, capsysbinary)


def test_the_command_lists_reads_and_writes(mem: Command, board: cm.Board, tmp_path: Path) -> None:
    listing = mem("list").decode().splitlines()
    assert any(line.split()[:6] == ["taps", "0x21000", "4096", "rw", "int16", "32x64"] for line in listing)
    mem("write", "taps", "--values", "-1", "0x1234", "--offset", "0x10")
    assert board.memories["taps"].read(16, 4).tolist() == [-1, 0x1234]
    assert mem("read", "taps", "--offset", "16", "--length", "4").split()[:2] == [b"00000010", b"1234ffff"]
    file = tmp_path / "taps.npy"
    mem("read", "taps", "-o", str(file))
    values = np.load(file)
    assert (values.shape, values.dtype) == ((32, 64), np.int16)
    values[31] = 9
    np.save(file, values)
    mem("write", "taps", str(file))
    assert np.array_equal(board.memories["taps"].read(), values)


def test_the_command_takes_and_gives_plain_bytes(mem: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"12345678")))
    mem("write", "scratch", "-", "--offset", "4")
    assert mem("read", "scratch", "--offset", "4", "--length", "8", "-o", "-") == b"12345678"
    file = tmp_path / "scratch.bin"
    assert b"8 bytes" in mem("read", "scratch", "--offset=4", "--length=8", "-o", str(file))
    assert file.read_bytes() == b"12345678"


def test_the_command_speaks_json(mem: Command, board: cm.Board) -> None:
    board.memories["scratch"].write(b"\1\2\3\4")
    read = json.loads(mem("read", "scratch", "--length", "4", "--json"))
    assert read == {"name": "scratch", "offset": 0, "length": 4, "dtype": "uint8", "shape": [4], "hex": "01020304"}
    wrote = json.loads(mem("write", "scratch", "--values", "5", "6", "7", "8", "--json"))
    assert wrote == {"name": "scratch", "offset": 0, "length": 4}
    board.configure_memory("cli", 0x60300, 64)
    assert "cli" in {memory["name"] for memory in json.loads(mem("list", "--json"))}
    status, refused = mem.ended("read", "scratch", "--offset", "2", "--length", "4", "--json")
    assert (status, json.loads(refused)["error"]["code"]) == (1, "invalid_request")


def test_the_command_says_what_it_cannot_read_or_write(mem: Command, tmp_path: Path) -> None:
    named, empty, huge = (tmp_path / f"{name}.npy" for name in ("named", "empty", "huge"))
    named.write_text("only named so")
    empty.touch()
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,)}\n"
    huge.write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
    for arguments, words in (
        (("write", "scratch", str(named)), b"named.npy cannot be read as .npy: the magic string is not correct"),
        (("write", "scratch", str(empty)), b"empty.npy cannot be read as .npy"),
        (("write", "scratch", str(huge)), b"huge.npy cannot be read as .npy"),
        (("write", "scratch", str(tmp_path)), b"cannot be read: Is a directory"),
        (("write", "scratch", str(tmp_path / "none.npy")), b"none.npy cannot be read"),
        (("write", "scratch", "--values", "one"), b"the memory has uint8"),
        (("read", "scratch", "-o", str(tmp_path / "no" / "file")), b"no/file: No such file"),
    ):
        status, _ = mem.ended(*arguments)
        assert status == 1
        assert words in mem.err
    assert mem.ended("write", "scratch")[0] == 2

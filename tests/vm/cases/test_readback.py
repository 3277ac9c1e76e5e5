# SPDX-License-Identifier: Apache-2.0
"""Reading a configuration port through the real driver: bits that turned over, and what can go wrong on the way."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest
from boardfile import write_bitstreams
from served import PATIENCE, until

from cm import device
from cm.device import IcapErrors
from cm.formats.bitstream import device_by_name, open_image, to_dma_words
from cm.formats.bitstream.geometry import frame_order
from cm.formats.bitstream.mask import Mask
from cm.formats.bitstream.readback import LoadedFrames, Slice, WrongFrame, repair_words

pytestmark = pytest.mark.needs("cm", "dma", "plsim")
PART = device_by_name("xc7z020")
CLOSING_AT, REPLY_AT = 4096, 8192


def asked(port: device.Icap, part: Slice) -> device.DmaBuffer:
    """Start a read; gives the buffer that it works in."""
    buffer = port.allocate(REPLY_AT + part.reply_length)
    whole = buffer.array()
    whole[: len(part.request)] = bytearray(part.request)
    whole[CLOSING_AT : CLOSING_AT + len(part.closing)] = bytearray(part.closing)
    ask, end = slice(0, len(part.request)), slice(CLOSING_AT, CLOSING_AT + len(part.closing))
    port.read(buffer, ask, slice(REPLY_AT, REPLY_AT + part.reply_length), end)
    return buffer


class Port:
    """A port of its own with one load in it, and the debugfs folder of its engine."""

    def __init__(self, engine: Path, folder: Path, port: device.Icap) -> None:
        assert PART is not None
        write_bitstreams(folder)
        image = (folder / "loopback.bit").read_bytes()
        self.engine, self.port, self.words = engine, port, to_dma_words(image)
        self.loaded = LoadedFrames(PART, open_image(image), Mask(lambda _: {}, "none"))

    def load(self, words: bytes) -> device.IcapCompletion:
        with self.port.allocate(len(words)) as buffer:
            buffer.array(0, len(words))[:] = bytearray(words)
            self.port.load(buffer, len(words))
            return self.port.wait(PATIENCE)

    def read(self, part: Slice) -> tuple[device.IcapCompletion, tuple[WrongFrame, ...]]:
        with asked(self.port, part) as buffer:
            done = self.port.wait(PATIENCE)
            reply = bytes(buffer.array()[REPLY_AT : REPLY_AT + part.reply_length])
        return done, part.judge(reply) if done.ok else ()

    def check(self) -> list[WrongFrame]:
        """All that is wrong."""
        found = []
        for part in self.loaded.slices(16):
            done, wrong = self.read(part)
            assert done.ok, done.reason
            found += wrong
        return found

    @property
    def part(self) -> Slice:
        """The first frames."""
        return next(iter(self.loaded.slices(16)))

    def upset(self, far: int, bit: int) -> None:
        (self.engine / "icap/upset").write_text(f"{far:#x} {bit}")

    def set(self, name: str, value: int) -> None:
        (self.engine / name).write_text(str(value))

    def get(self, name: str) -> int:
        return int((self.engine / name).read_text(), 0)


@contextlib.contextmanager
def boards(folder: Path, timeout_ms: int = 600_000) -> Iterator[Port]:
    channels: dict[str, plsim.Attributes] = {
        "icap": {"kind": "icap", "idcode": "0x03727093", "timeout_ms": timeout_ms},
        "icap_read": {"kind": "readback", "peer": "icap"},
    }
    with plsim.nothing(), plsim.board(channels, {}) as engine, device.Icap.open() as opened:
        yield Port(engine, folder, opened)


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Port]:
    with boards(tmp_path) as found:
        assert found.load(found.words).ok
        yield found


def test_bits_that_turn_over_are_found_and_mended(port: Port) -> None:
    assert port.check() == []
    hits = [(0x400000, 0), (0x400010, 32 * 50 + 7), (0x400028, 32 * 100 + 31)]
    for far, bit in hits:
        port.upset(far, bit)
    wrong = port.check()
    assert [(frame.far, frame.bits) for frame in wrong] == [(far, (bit,)) for far, bit in hits]
    repair = port.loaded.repair(wrong)
    assert repair is not None
    assert port.load(repair).ok
    assert port.check() == []


def test_a_hundred_hits_are_found_each_in_one_pass(port: Port) -> None:
    for number in range(100):
        far, bit = 0x400000 + number % 41, number * 37 % 3232
        port.upset(far, bit)
        ((found),) = port.check()
        assert (found.far, found.bits) == (far, (bit,))
        port.upset(far, bit)


def test_a_run_goes_on_in_the_next_column_as_the_device_counts(port: Port) -> None:
    assert PART is not None
    order = frame_order(PART.name, PART.family)
    assert order is not None
    table = b"".join((0xFFFFFFFF if far is None else far).to_bytes(4, "little") for far in order.order)
    (port.engine / "icap/frame_order").write_bytes(table)
    last = [far for far in order.place if far >> 7 == 0x400000 >> 7][-1]
    frames = [bytes([number + 1]) * 404 for number in range(4)]
    assert port.load(to_dma_words(repair_words(PART, [(last - 1, frames)]))).ok
    for far in (last - 1, last, order.order[order.place[last] + 1]):
        port.upset(far or 0, 5)
    with pytest.raises(OSError):
        port.upset(last + 1, 5)  # no such frame


@pytest.mark.parametrize("text", ["", "1", "x y", "0x400000 3232", "0x400000 99999999999"])
def test_what_is_no_bit_of_a_frame_does_not_turn_over(port: Port, text: str) -> None:
    with pytest.raises(OSError, match="Invalid"):
        (port.engine / "icap/upset").write_text(text or " ")
    assert port.check() == []


@pytest.mark.parametrize(("channel", "length"), [("icap", 0), ("icap_read", 0)])
def test_an_error_of_the_engine_is_told_and_the_port_is_closed(port: Port, channel: str, length: int) -> None:
    port.set(f"{channel}/fail_next", 1)
    done, _ = port.read(port.part)
    assert (done.status, done.length) == (-errno.EIO, length)
    assert IcapErrors.DMA in done.errors
    assert (port.engine / "icap/synced").read_text().strip() == "N"
    assert port.check() == []
    assert port.load(port.words).ok


def test_an_answer_that_ends_early_is_told_with_its_length(port: Port) -> None:
    port.set("icap_read/short_next", 512)
    done, _ = port.read(port.part)
    assert (done.status, done.errors, done.length) == (-errno.ETIMEDOUT, IcapErrors.TIMEOUT, 512)
    assert port.check() == []


def test_an_answer_that_does_not_come_is_given_up_and_not_taken_for_the_next(tmp_path: Path) -> None:
    with boards(tmp_path, timeout_ms=2000) as port:
        assert port.load(port.words).ok
        port.set("icap_read/hang", 1)
        done, _ = port.read(port.part)
        assert (done.status, done.errors, done.length) == (-errno.ETIMEDOUT, IcapErrors.TIMEOUT, 0)
        port.set("icap_read/hang", 0)
        port.upset(0x400001, 9)
        assert [(frame.far, frame.bits) for frame in port.check()] == [(0x400001, (9,))]


def test_a_file_that_is_closed_waits_for_its_read(port: Port) -> None:
    port.set("icap_read/delay_us", 200_000)
    before, reads = port.port.status().loads, port.get("icap/reads")
    other = device.Icap.open()
    buffer = asked(other, port.part)
    other.close()
    assert (port.port.status().loads, port.get("icap/reads")) == (before + 1, reads + 1)
    assert not port.port.status().loading
    buffer.close()
    port.set("icap_read/delay_us", 0)
    assert port.check() == []


@pytest.mark.parametrize("driver", ["cm_icap", "cm_plsim_dma"])
def test_a_driver_that_is_unbound_during_a_read_ends_it_first(port: Port, driver: str) -> None:
    name = port.engine.name.replace("cm_plsim_dma", driver)
    folder = Path("/sys/bus/platform/drivers", driver)
    port.set("icap_read/delay_us", 200_000)
    with asked(port.port, port.part):
        (folder / "unbind").write_text(name)
        done = port.port.wait(PATIENCE)
        assert done.status in (0, -errno.EIO, -errno.ETIMEDOUT, -errno.ENODEV)
        with pytest.raises(device.DeviceGone):
            port.port.status()
    (folder / "bind").write_text(name)
    until(device.list_icap)
    with device.Icap.open(device.list_icap()[0]) as again:  # its number is another one while a file is open
        assert again.info.readable


def test_a_port_without_a_way_back_refuses(tmp_path: Path) -> None:
    channels: dict[str, plsim.Attributes] = {"icap": {"kind": "icap"}}
    with plsim.nothing(), plsim.board(channels, {}), device.Icap.open() as port, port.allocate(8192) as buffer:
        assert not port.info.readable
        with pytest.raises(device.DeviceUnsupported):
            port.read(buffer, slice(0, 4), slice(4, 8), slice(8, 12))

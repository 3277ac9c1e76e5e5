# SPDX-License-Identifier: Apache-2.0
"""Lines of GPIO chips through the shim, on the simulated board's chips and on nodes that answer wrongly."""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_node import FakeNode, Handler, Reply

from cm.device import (
    DeviceBusy,
    DeviceClosed,
    DeviceError,
    DeviceGone,
    DeviceInvalid,
    DeviceNotFound,
    GpioChip,
    GpioLine,
    list_gpio,
)
from cm.simulation.software import Board as SimBoard

TEXT = """
config:
  name: emio
  type: partial
  device: xc7z020
  regions:
    left: {decoupler: {gpio: {chip: zynq_gpio, line: 54}}}
    right: {decoupler: {gpio: {chip: gpiochip4, line: 40}, active_high: false}}
  modules:
    a: {region: left}
    b: {region: right}
  modes:
    default: {modules: [a, b]}
"""


@pytest.fixture(scope="module")
def schema(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("emio") / "emio.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def sim(schema: Path) -> Iterator[SimBoard]:
    with SimBoard([schema]) as board:
        yield board


def decoupled(sim: SimBoard, region: str) -> bool:
    return bool(sim.control.state()["regions"][region]["decoupled"])


def test_chips_are_listed_with_label_and_lines(sim: SimBoard) -> None:
    assert list_gpio(sim.root) == [GpioChip("gpiochip0", "zynq_gpio", 118), GpioChip("gpiochip4", "gpiochip4", 41)]


@pytest.mark.parametrize("name", ["zynq_gpio", "gpiochip0"])
def test_a_line_of_a_chip_by_label_or_name_cuts_its_region_off(sim: SimBoard, name: str) -> None:
    with GpioLine.open(name, 54, sim.root) as line:
        line.value = 1
        assert (line.value, decoupled(sim, "left"), decoupled(sim, "right")) == (1, True, False)
        line.value = 0
        assert (line.value, decoupled(sim, "left")) == (0, False)


def test_an_active_low_line_cuts_off_at_0(sim: SimBoard) -> None:
    with GpioLine.open("gpiochip4", 40, sim.root) as line:
        assert (line.value, decoupled(sim, "right")) == (1, False)
        line.value = 0
        assert decoupled(sim, "right")
        line.value = 1


def test_taking_a_line_changes_nothing_and_the_processors_chip_keeps_it_afterwards(sim: SimBoard) -> None:
    with GpioLine.open("zynq_gpio", 54, sim.root) as line:
        line.value = 1
    assert decoupled(sim, "left")
    with GpioLine.open("zynq_gpio", 54, sim.root) as line:
        assert (line.value, decoupled(sim, "left")) == (1, True)
        line.value = 0


def test_a_line_that_is_held_is_busy_until_it_is_closed(sim: SimBoard) -> None:
    with GpioLine.open("zynq_gpio", 60, sim.root):
        with pytest.raises(DeviceBusy, match=r"line 60: .*gpioinfo") as caught:
            GpioLine.open("zynq_gpio", 60, sim.root)
        assert caught.value.errno == errno.EBUSY
        GpioLine.open("zynq_gpio", 61, sim.root).close()
    GpioLine.open("zynq_gpio", 60, sim.root).close()


def test_a_line_that_the_chip_does_not_have_is_invalid(sim: SimBoard) -> None:
    with pytest.raises(DeviceInvalid, match="lines 0 to 117"):
        GpioLine.open("zynq_gpio", 118, sim.root)
    with pytest.raises(DeviceInvalid, match="0 or more"):
        GpioLine.open("zynq_gpio", -1, sim.root)


def test_a_chip_that_is_not_there_is_not_found_with_those_that_are(sim: SimBoard) -> None:
    with pytest.raises(DeviceNotFound, match=r"gpiochip0 \(zynq_gpio\)"):
        GpioLine.open("zynqmp_gpio", 78, sim.root)


def test_a_closed_line_cannot_be_used(sim: SimBoard) -> None:
    line = GpioLine.open("zynq_gpio", 62, sim.root)
    line.close()
    line.close()
    with pytest.raises(DeviceClosed):
        line.value = 1
    with pytest.raises(DeviceClosed):
        _ = line.value


def test_a_line_of_a_board_that_has_gone_fails_as_gone(schema: Path) -> None:
    with SimBoard([schema]) as board:
        line = GpioLine.open("zynq_gpio", 54, board.root)
    with pytest.raises(DeviceGone):
        line.value = 1
    line.close()


@pytest.mark.parametrize(("number", "kind"), [(errno.EPERM, PermissionError), (errno.EIO, DeviceError)])
def test_what_the_driver_refuses_keeps_its_errno(tmp_path: Path, number: int, kind: type[OSError]) -> None:
    def refuse(op: int, payload: bytes, fds: list[int], events: object) -> Reply:
        return number, b"", []

    with FakeNode(tmp_path, "dev/gpiochip0", refuse), pytest.raises(kind) as caught:
        GpioLine.open("gpiochip0", 3, tmp_path)
    assert caught.value.errno == number


def test_an_answer_without_a_line_is_refused(tmp_path: Path) -> None:
    def forget(op: int, payload: bytes, fds: list[int], events: object) -> Reply:
        return 0, payload, []

    with FakeNode(tmp_path, "dev/gpiochip0", forget), pytest.raises(DeviceError) as caught:
        GpioLine.open("gpiochip0", 3, tmp_path)
    assert caught.value.errno == errno.EPROTO


def chip_with_names(names: list[str], taken: list[tuple[int, int]]) -> Handler:
    """A chip whose lines have names, as the device tree gives them; notes place and flags of what is asked for."""

    def answer(op: int, payload: bytes, fds: list[int], events: object) -> Reply:
        if op & 0xFF == 0x01:
            return 0, struct.pack("<32s32sI", b"gpiochip0", b"chip", len(names)), []
        if op & 0xFF == 0x05:
            (place,) = struct.unpack_from("<I", payload, 64)
            return 0, names[place].encode().ljust(32, b"\0") + payload[32:], []
        (place,), (flags,) = struct.unpack_from("<I", payload), struct.unpack_from("<Q", payload, 288)
        taken.append((place, flags))
        return errno.EBUSY, b"", []

    return answer


def test_a_line_is_found_by_its_name_and_may_be_active_low(tmp_path: Path) -> None:
    taken: list[tuple[int, int]] = []
    with FakeNode(tmp_path, "dev/gpiochip0", chip_with_names(["", "prr0-cut", "prr1-cut"], taken)):
        for name, low in (("prr1-cut", False), ("prr0-cut", True)):
            with pytest.raises(DeviceBusy, match=f"line {name}"):
                GpioLine.open("gpiochip0", name, tmp_path, active_low=low)
    assert taken == [(2, 0), (1, 2)]


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("prr7-cut", DeviceNotFound, "no line of that name"),
        ("twice", DeviceError, "several lines"),
        ("", DeviceNotFound, "no line"),
    ],
)
def test_a_name_that_no_line_or_several_have_is_refused(
    tmp_path: Path, name: str, kind: type[DeviceError], words: str
) -> None:
    with (
        FakeNode(tmp_path, "dev/gpiochip0", chip_with_names(["", "twice", "twice"], [])),
        pytest.raises(kind, match=words),
    ):
        GpioLine.open("gpiochip0", name, tmp_path)


def test_two_chips_of_one_label_have_to_be_distinguished_by_name(tmp_path: Path) -> None:
    def describe(op: int, payload: bytes, fds: list[int], events: object) -> Reply:
        return 0, struct.pack("<32s32sI", b"gpiochipN", b"gpio-expander", 8), []

    with (
        FakeNode(tmp_path, "dev/gpiochip1", describe),
        FakeNode(tmp_path, "dev/gpiochip2", describe),
        pytest.raises(DeviceInvalid, match="gpiochip1, gpiochip2 have that label"),
    ):
        GpioLine.open("gpio-expander", 3, tmp_path)

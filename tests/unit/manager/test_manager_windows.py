# SPDX-License-Identifier: Apache-2.0
"""Windows of the manager: where they are refused, and what happens if the pages cannot be taken back."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from manager_support import CAMERA, Rig, rig

from cm.device import DeviceError, Root
from cm.device.errors import device_error
from cm.device.window import WindowEnd, WindowEvent
from cm.errors import Busy, CmError
from cm.manager.access.windows import Loan, WindowRequest
from cm.manager.errors import NoWindow, RegionBusy
from cm.schema import loads
from cm.server.devices import BoardDevices
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import RegWrite


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with SimBoard([CAMERA], arguments=["--icap-rate", "0"]) as board:
        yield board


@pytest.fixture
def made(sim: SimBoard, tmp_path: Path) -> Iterator[Rig]:
    with rig(sim.root, tmp_path) as found:
        assert found.go("edge_detection") is None
        yield found


class Lender:
    """Lends nothing, and says why."""

    def __init__(self, number: int) -> None:
        self._number = number

    def grant(self, address: int, length: int, write: bool = False) -> Any:
        raise device_error(self._number, f"lend 0x{address:x}+0x{length:x} by", "/dev/cm_window")

    def close(self) -> None: ...


class Kernel(Lender):
    """Lends to all, and takes back what `ended` says."""

    def __init__(self) -> None:
        super().__init__(0)
        self._ids = count(1)
        self.ended: list[WindowEvent] = []

    def grant(self, address: int, length: int, write: bool = False) -> Any:
        return SimpleNamespace(id=next(self._ids), fd=os.memfd_create("pages"))

    def take(self) -> list[WindowEvent]:
        ended, self.ended = self.ended, []
        return ended


def lend(found: Rig, devices: Any = None, told: list[tuple[int, str, str]] | None = None, **asked: Any) -> Loan:
    request = WindowRequest("edge", write=True, client="me", **asked)
    ended = (lambda *what: None) if told is None else lambda *what: told.append(what)
    loan, fd = found.manager.windows.lend(request, devices or found.given, ended)
    os.close(fd)
    return loan


@pytest.mark.parametrize(
    ("number", "kind", "says"),
    [
        (errno.ENXIO, NoWindow, "smaller than a page"),
        (errno.EINVAL, NoWindow, "smaller than a page"),
        (errno.EPERM, NoWindow, "another driver has registers in them"),
        (errno.EAGAIN, RegionBusy, "cut off"),
        (errno.ENOSPC, Busy, "as many as it may"),
        (errno.EIO, DeviceError, "cannot lend"),
    ],
)
def test_what_the_kernel_refuses_is_a_sentence(made: Rig, number: int, kind: type[CmError], says: str) -> None:
    with pytest.raises(kind, match=says):
        lend(made, SimpleNamespace(windows=lambda: Lender(number)))
    assert made.manager.mapped == ()
    assert made.manager.leases.told() == ()


def test_pages_that_another_region_has_registers_in_are_not_lent(sim: SimBoard, tmp_path: Path) -> None:
    text = CAMERA.read_text("utf-8")
    shared = text.replace("{base_address: 0x6000, offset: 0x1000}", "{base_address: 0x2000, offset: 0x1800}")
    assert shared != text
    config = loads(shared, source=CAMERA)
    with rig(sim.root, tmp_path, config) as found:
        assert found.go("edge_detection") is None
        with pytest.raises(NoWindow, match=r"identity of region prr1 lies in the pages of edge \(0x3000 to 0x3fff\)"):
            lend(found)


def test_a_window_has_the_memories_that_end_within_it(sim: SimBoard, tmp_path: Path) -> None:
    text = CAMERA.read_text("utf-8")
    with_memories = text.replace(
        "          registers:\n            threshold:",
        "          memories: {last: {offset: 0x1f00, size: 0x100}, beyond: {offset: 0x2000, size: 0x100}}\n"
        "          registers:\n            threshold:",
    )
    with rig(sim.root, tmp_path, loads(with_memories, source=CAMERA)) as found:
        assert found.go("edge_detection") is None
        found.manager.windows.collect()  # nothing was lent yet
        assert [memory.name for memory in lend(found).place.memories] == ["last"]


def test_a_board_without_the_node_says_why(tmp_path: Path) -> None:
    with pytest.raises(NoWindow, match=r"^this simulated board .* \(--sim=rtl, --sim=bits\); they go by"):
        BoardDevices(Root.of(tmp_path)).windows()


@pytest.mark.skipif(Path("/dev/cm_window").exists(), reason="the kernel module is loaded here")
def test_a_kernel_without_the_module_is_told_by_its_name() -> None:
    with pytest.raises(NoWindow, match=r"^the kernel module .* \(modprobe cm_window\); they go by"):
        BoardDevices(Root.of("/")).windows()


def test_a_change_takes_windows_back_before_it_cuts_the_region_off(made: Rig) -> None:
    told: list[tuple[int, str, str]] = []
    lend(made, told=told)
    made.arm(-1)
    assert made.go("default") is None
    names = made.fault.names
    assert names.index("window.revoke") < names.index("uio.write")
    assert told == [(1, "camera", "default")]


def test_what_a_window_wrote_is_there_after_a_failed_change_however_busy_the_machine_is(
    made: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cm.manager.access.windows._READING", -1.0)
    threshold = next(r for r in lend(made).place.registers if r.name == "threshold")
    window = made.devices.window(threshold.address, threshold.width)
    window.device.write(window.offset, 99, threshold.width, window.map)
    loads: list[str] = []

    def watch(name: str) -> None:
        loads.extend([name] if name == "icap.load" else [])
        _fail(name == "icap.load" and len(loads) == 1)

    made.fault.watch = watch
    assert made.go("default") is not None
    assert len(loads) > 1  # the way back
    assert made.manager.registers.read(("threshold",)).values[0].value == 99


def test_what_a_client_gives_back_is_taken_from_the_kernel_and_what_it_wrote_is_known(made: Rig) -> None:
    loan = lend(made)
    threshold = next(r for r in loan.place.registers if r.name == "threshold")
    window = made.devices.window(threshold.address, threshold.width)
    window.device.write(window.offset, 99, threshold.width, window.map)
    made.arm(-1)
    told = made.manager.windows.give_back(loan.number)
    assert told is not None
    assert [(value.name, value.value) for value in told.values] == [("threshold", 99)]
    assert made.manager.state.values["threshold"] == 99
    assert "window.revoke_grant" in made.fault.names
    assert made.manager.mapped == ()


def test_a_change_ends_where_windows_cannot_be_taken_back(made: Rig) -> None:
    """They are lent still, and the next change takes them."""
    told: list[tuple[int, str, str]] = []
    lend(made, told=told)
    made.fault.watch = lambda name: _fail(name == "window.revoke")
    error = made.go("default")
    assert error is not None
    assert (error.code, made.manager.state.mode) == ("device_error", "edge_detection")
    assert told == []
    assert len(made.manager.mapped) == 1
    made.fault.watch = lambda name: None
    assert made.go("default") is None
    assert told == [(1, "camera", "default")]


def test_what_the_kernel_took_back_is_told_to_its_holder_and_not_known_any_more(made: Rig) -> None:
    lender, told, others = Kernel(), list[tuple[int, str, str]](), list[tuple[int, str, str]]()
    devices = SimpleNamespace(windows=lambda: lender)
    taken = lend(made, devices, told)
    lend(made, devices, others)
    made.manager.write_registers((RegWrite("threshold", 9),), "")
    assert made.manager.state.values["threshold"] == 9
    lender.ended = [WindowEvent(taken.id, WindowEnd.BRIDGE)]
    made.manager.windows.collect()
    made.manager.windows.collect()  # nothing more
    assert told == [(int(WindowEnd.BRIDGE), "camera", "edge_detection")]
    assert (others, len(made.manager.mapped)) == ([], 1)
    assert "threshold" not in made.manager.state.values


def _fail(here: bool) -> None:
    if here:
        raise DeviceError(errno.EIO, "injected")

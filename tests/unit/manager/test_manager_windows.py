# SPDX-License-Identifier: Apache-2.0
"""Windows of the manager: where they are refused, and what happens if the pages cannot be taken back."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from manager_schemas import written
from manager_support import CAMERA, Rig, rig

from cm.device import DeviceError, Root
from cm.device.errors import device_error
from cm.device.register_window import WindowEnd, WindowEvent
from cm.errors import Busy, CmError
from cm.manager.access.register_windows import Loan, WindowRequest
from cm.manager.errors import NoWindow, RegionBusy
from cm.schema import loads
from cm.schema.model import Register
from cm.server.devices import BoardDevices
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import BreakLease, RegWrite, TakeLease
from cm.wire.messages.status import ErrorInfo, WindowStatus

OUT = "; CM_LEASE=ID (lease=ID in Python) if it is yours; cm lease break 1 ends it (for administrators)"


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
        self.granted: list[tuple[int, int, bool]] = []
        self.ended: list[WindowEvent] = []

    def revoke(self, address: int, length: int) -> int:
        return 1

    def revoke_grant(self, number: int) -> None: ...

    def fileno(self) -> int:
        return 99

    def grant(self, address: int, length: int, write: bool = False) -> Any:
        self.granted.append((address, length, write))
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


PAGES, BY_REQUESTS = "the pages 0x3000 to 0x3fff", "; the registers go by requests as before"
SMALL = "one that is smaller than a page cannot be lent"


@pytest.mark.parametrize(
    ("number", "kind", "says"),
    [
        (
            errno.ENXIO,
            NoWindow,
            f"{PAGES} cannot be lent: no window of the board has all of them: {SMALL}{BY_REQUESTS}",
        ),
        (
            errno.EINVAL,
            NoWindow,
            f"{PAGES} cannot be lent: the board's window there is no whole pages: {SMALL}{BY_REQUESTS}",
        ),
        (errno.EPERM, NoWindow, f"{PAGES} cannot be lent: another driver has registers in them{BY_REQUESTS}"),
        (errno.EAGAIN, RegionBusy, f"{PAGES} lie in region prr0, which is cut off"),
        (errno.ENOSPC, Busy, f"{PAGES} cannot be lent now: the kernel has lent as many as it may"),
        (errno.EIO, DeviceError, "cannot lend"),
    ],
)
def test_what_the_kernel_refuses_is_a_sentence(made: Rig, number: int, kind: type[CmError], says: str) -> None:
    with pytest.raises(kind, match=f"^{says}"):
        lend(made, SimpleNamespace(windows=lambda: Lender(number)))
    assert made.manager.mapped == ()
    assert made.manager.leases.statuses() == ()


@pytest.mark.parametrize(
    ("what", "place", "offset"),
    [
        ("identity", "base_address: 0x6000, offset: 0x1000", 0x1800),
        ("decoupler", "base_address: 0x1000, offset: 0x0, bit: 1", 0x1800),
        ("", "base_address: 0x1000, offset: 0x0, bit: 1", 0x2000),  # behind them
    ],
)
def test_pages_that_another_region_has_registers_in_are_not_lent(
    sim: SimBoard, tmp_path: Path, what: str, place: str, offset: int
) -> None:
    text = CAMERA.read_text("utf-8")
    shared = text.replace(place, f"base_address: 0x2000, offset: {offset}")
    assert shared != text
    config = loads(shared, source=CAMERA)
    with rig(sim.root, tmp_path, config) as found:
        assert found.go("edge_detection") is None
        if not what:
            lend(found)
            return
        with pytest.raises(NoWindow, match=rf"{what} of region prr1 lies in the pages of edge \(0x3000 to 0x3fff\)"):
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


@pytest.mark.parametrize("sure", [2, 3])  # of focus, zoom and threshold
def test_what_a_window_wrote_is_there_after_a_failed_change_or_forgotten_where_the_machine_is_busy(
    made: Rig, monkeypatch: pytest.MonkeyPatch, sure: int
) -> None:
    monkeypatch.setattr("cm.manager.access.register_windows._READING", -1.0)
    monkeypatch.setattr("cm.manager.access.register_windows._SURE", sure)
    made.manager.write_registers((RegWrite("threshold", 9), RegWrite("focus", 3)))
    recorded = [r for r in lend(made).place.registers if r.name in ("threshold", "focus")]
    for register in recorded:
        by_hand(made, register, 7)
    loads: list[str] = []

    def watch(name: str) -> None:
        loads.extend([name] if name == "icap.load" else [])
        _fail(name == "icap.load" and len(loads) == 1)

    made.fault.watch = watch
    assert made.go("default") is not None
    assert len(loads) > 1  # the way back
    values = [value.value for value in made.manager.registers.read(tuple(r.name for r in recorded)).values]
    assert [value == 7 for value in values] == [True, sure == 3]


def by_hand(made: Rig, register: Register, value: int) -> None:
    """Write as who has the window does."""
    window = made.devices.window(register.address, register.width)
    window.device.write(window.offset, value, register.width, window.map)


def test_what_a_client_gives_back_is_taken_from_the_kernel_and_what_it_wrote_is_known(
    sim: SimBoard, tmp_path: Path
) -> None:
    text = CAMERA.read_text("utf-8")
    unset = text.replace("default: 1\n          min: 1", "min: 1")  # zoom, which nobody has written then
    assert unset != text
    with rig(sim.root, tmp_path, loads(unset, source=CAMERA)) as made:
        assert made.go("edge_detection") is None
        loan = lend(made)
        for register in loan.place.registers:
            if register.name in ("threshold", "zoom"):
                by_hand(made, register, 7)
        made.arm(-1)
        told = made.manager.windows.give_back(loan.number)
        assert told is not None
        assert {value.name: value.value for value in told.values} == {"zoom": 7, "threshold": 7}
        assert {"zoom": 7, "threshold": 7}.items() <= made.manager.state.values.items()
        assert "window.revoke_grant" in made.fault.names
        assert made.manager.mapped == ()


def test_a_change_ends_where_windows_cannot_be_taken_back_and_the_next_takes_them_first(made: Rig) -> None:
    told: list[tuple[int, str, str]] = []
    lend(made, told=told)
    made.fault.watch = lambda name: _fail(name == "window.revoke")
    error = made.go("default")
    assert error is not None
    assert (error.code, made.manager.state.mode) == ("device_error", "edge_detection")
    assert told == []
    assert len(made.manager.mapped) == 1
    made.fault.watch = lambda name: None
    made.arm(-1)
    assert made.go("default") is None
    assert told == [(1, "camera", "default")]
    assert made.fault.names.index("window.revoke") < made.fault.names.index("uio.write")


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
    assert lender.granted == [(0x3000, 0x1000, True)] * 2
    assert "threshold" not in made.manager.state.values


def asked(made: Rig, **asked: Any) -> Any:
    """A window that the kernel grants, or the error."""
    devices: Any = SimpleNamespace(windows=Kernel)
    request = WindowRequest(**{"name": "edge", "write": True, "client": "me", **asked})
    try:
        loan, fd = made.manager.windows.lend(request, devices, lambda *_: None)
    except CmError as error:
        return f"{type(error).__name__}: {error}"
    os.close(fd)
    return loan


ALONE = "InvalidRequest: an exclusive window is one for writing, of a region: it goes with a lease on that"


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        ({"exclusive": True, "write": False}, ALONE),
        (
            {"name": "static"},
            "NoWindow: the decoupler of region prr0 lies in the pages of the static part (0x1000 to 0x1fff), so they "
            "cannot be lent: a window of 4096 bytes of its own, aligned to as many, can; the registers go by requests "
            "as before",
        ),
        ({"name": "default"}, "ModuleAbsent: module 'default' is not loaded: region prr0 holds edge"),
        ({"name": "loopback"}, "ModuleAbsent: module 'loopback' is not loaded: region prr1 holds none"),
        ({"name": "b0"}, "ModuleAbsent: module 'b0' is not loaded: it is one of configuration 'duo'"),
        ({"name": "edgy"}, "NotFound: no module, region or block 'edgy'; did you mean 'edge'?"),
        ({"name": "prr1"}, "RegionBusy: window 'prr1' lies in region prr1, which is unknown"),
        ({"lease": "mine"}, f"HeldBy: registers:threshold is held by anna (alone), for 30 s more unless renewed{OUT}"),
    ],
)
def test_a_window_that_cannot_be_lent_says_why(made: Rig, tmp_path: Path, request_: Any, text: str) -> None:
    made.manager.add_config(written(tmp_path, ("duo",))["duo"])
    if "lease" in request_:
        made.manager.leases.request(TakeLease("registers:threshold", holder="anna"))
    assert asked(made, **request_) == text
    assert (made.manager.mapped, len(made.manager.leases.held())) == ((), int("lease" in request_))


def test_windows_of_nothing_or_of_what_has_no_registers_are_refused(sim: SimBoard, tmp_path: Path) -> None:
    text = CAMERA.read_text("utf-8").replace("      region: prr1\n      registers:", "      registers:")
    with rig(sim.root, tmp_path, loads(text, source=CAMERA)) as found:
        assert asked(found) == "NothingLoaded: nothing is loaded, so there is no window 'edge'"
        assert found.go("loopback") is None
        assert asked(found, name="prr1") == "NoWindow: 'prr1' has no registers"


def test_a_window_of_a_board_in_no_mode_has_what_all_modes_have(made: Rig) -> None:
    config = made.manager.configs["camera"]
    made.manager.add_config(replace(config, modes={name: config.modes[name] for name in ("default", "loopback")}))
    loan = asked(made)
    assert (loan.info.mode, "threshold" in {register.name for register in loan.info.registers}) == ("", True)


def test_a_window_tells_what_is_in_it_and_who_has_it(made: Rig) -> None:
    changes: list[int] = []
    made.manager.windows.changed = lambda: changes.append(len(made.manager.mapped))
    loan = asked(made, name="prr0", exclusive=True, pid=7)
    told = WindowStatus(loan.number, "prr0", "edge", 0x3000, 0x1000, True, True, "me", 7)
    assert made.manager.mapped == (told,)
    assert (loan.info.name, loan.info.type, loan.info.mode) == ("camera", "partial", "edge_detection")
    assert {"focus", "threshold"} <= {register.name for register in loan.info.registers}
    (lease,) = made.manager.leases.statuses()
    assert (lease.scope, lease.holder, lease.client, lease.pid) == ("region:prr0", f"window {loan.number}", "me", 7)
    held = f"HeldBy: region:prr0 is held by window {loan.number} (alone), until that is given back"
    assert asked(made) == held + OUT
    reader = asked(made, write=False)
    made.manager.windows.give_back(loan.number)
    made.manager.windows.give_back(loan.number)  # nothing more
    assert (made.manager.leases.statuses(), len(made.manager.mapped)) == ((), 1)
    writer = asked(made)
    assert asked(made, exclusive=True) == "HeldBy: region prr0 has a window for writing already, of me"
    assert [window.number for window in made.manager.mapped] == [reader.number, writer.number]
    assert changes == [1, 2, 1, 2]


@pytest.mark.parametrize("scope", ["registers:threshold", "region:prr0", "board", "region:prr1"])
def test_a_lease_of_another_ends_windows_for_writing_that_it_covers(made: Rig, scope: str) -> None:
    told: list[tuple[int, str, str]] = []
    kernel: Any = SimpleNamespace(windows=Kernel)
    lend(made, kernel, told)
    made.manager.windows.lend(WindowRequest("edge"), kernel, lambda *what: told.append(what))  # which only reads
    taken = made.manager.leases.request(TakeLease(scope, holder="anna"))
    over = scope != "region:prr1"
    assert told == [(int(WindowEnd.CALL), "camera", "edge_detection")] * over
    assert [window.writes for window in made.manager.mapped] == ([False] if over else [True, False])
    assert not over or not isinstance(asked(made, lease=taken.id), str)


def test_a_window_ends_with_its_lease_and_its_board(made: Rig) -> None:
    told: list[tuple[int, str, str]] = []
    kernel: Any = SimpleNamespace(windows=Kernel)
    lend(made, kernel, told, exclusive=True)
    (lease,) = made.manager.leases.statuses()
    made.manager.leases.request(BreakLease(lease.number))
    assert told == [(int(WindowEnd.CALL), "camera", "edge_detection")]
    lend(made, kernel, told)
    before = made.devices.uio("uio0")
    made.manager.board_lost(OSError("gone"))
    assert made.devices.uio("uio0") is not before
    assert told[1:] == [(int(WindowEnd.GONE), "camera", "edge_detection")]
    assert (made.manager.mapped, made.manager.windows.fileno()) == ((), -1)
    status = made.manager.status()
    assert status.last_error == ErrorInfo("device_gone", "the board does not answer: gone")
    assert status.pr_mode.value == "error"


@pytest.mark.parametrize("fails", [1, 99])
def test_what_cannot_be_read_again_is_not_known_any_more(made: Rig, fails: int) -> None:
    made.manager.write_registers((RegWrite("threshold", 9), RegWrite("focus", 3)))
    loan = lend(made)
    by_hand(made, next(r for r in loan.place.registers if r.name == "threshold"), 99)
    reads = count(1)
    made.fault.watch = lambda name: _fail(name == "uio.read" and next(reads) <= fails)
    told = made.manager.windows.give_back(loan.number)
    made.fault.watch = lambda _: None
    known = made.manager.state.values
    assert "focus" not in known
    assert (known.get("threshold"), told is None) == ((99, False) if fails == 1 else (None, True))


def _fail(here: bool) -> None:
    if here:
        raise DeviceError(errno.EIO, "injected")

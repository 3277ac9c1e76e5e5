# SPDX-License-Identifier: Apache-2.0
"""The manager's devices: opened when they are needed, kept as long as they are there; and a board that goes."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import DeviceBusy, DeviceGone, DeviceNotFound, Root
from cm.device.other_loads import Seen
from cm.errors import NotFound
from cm.manager.errors import NoWindow, UnknownConfig
from cm.server import board_watch, devices
from cm.server.board_watch import BoardWatch
from cm.server.devices import BoardDevices


class Opened:
    """Devices that tell what was opened and closed."""

    def __init__(self, root: Root) -> None:
        self.root, self.log = root, list[str]()

    def kind(self, kind: str) -> Any:
        def open_(*place: Any) -> Any:
            *name, root = place
            assert root is self.root
            text = f"{kind} {'/'.join(map(str, name))}"
            self.log.append(f"open {text}")
            return SimpleNamespace(
                name=text, present=True, status=lambda: self.log.append(f"ask {text}"),
                close=lambda: self.log.append(f"close {text}"), maps=(SimpleNamespace(address=0x100),) * 3,
            )  # fmt: skip

        return SimpleNamespace(open=open_)

    def said(self) -> list[str]:
        said = self.log[:]
        self.log.clear()
        return said


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Opened:
    made = Opened(Root.of(tmp_path))
    for name in ("Uio", "Icap", "GpioLine"):
        monkeypatch.setattr(devices, name, made.kind(name))
    return made


def test_what_is_open_is_used_again_until_it_has_gone_or_the_board_is_lost(opened: Opened) -> None:
    board = BoardDevices(opened.root)
    for _ in range(2):
        held = [board.uio("uio0"), board.icap(None), board.icap("port"), board.gpio("gpiochip0", 3), board.uio("uio1")]
    names = ["Uio uio0", "Icap cm_icap0", "Icap port", "GpioLine gpiochip0/3", "Uio uio1"]
    assert opened.said() == [f"open {name}" for name in names]
    assert not board.forget()
    for gone in (held[0], held[2], held[3]):
        gone.present = False
    assert board.forget()
    assert opened.said() == ["close Uio uio0", "close Icap port"]  # a line that is given back may change
    assert (board.uio("uio1"), board.icap("cm_icap0")) == (held[4], held[1])
    assert board.uio("uio0") is not held[0]
    opened.said()
    board.lost()
    assert sorted(opened.said()) == sorted(f"close {name}" for name in names if name != "Icap port")
    board.lost()
    assert opened.said() == []
    assert board.gpio("gpiochip0", 3) is not held[3]


def test_a_board_is_asked_by_its_ports_or_else_by_a_window(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    board = BoardDevices(opened.root)
    ports, windows = ["b", "a"], [SimpleNamespace(node="uio3"), SimpleNamespace(node="uio4")]
    monkeypatch.setattr(devices, "list_icap", lambda root: ports if root is opened.root else None)
    monkeypatch.setattr(devices, "list_uio", lambda root: windows if root is opened.root else None)
    board.check()
    assert opened.said() == ["open Icap a", "ask Icap a", "open Icap b", "ask Icap b"]
    ports.clear()
    board.check()  # those that are open still count
    assert opened.said() == ["ask Icap a", "ask Icap b"]
    board.lost()
    opened.said()
    board.check()
    assert opened.said() == ["open Uio uio3", "close Uio uio3"]


def test_a_register_lies_in_the_window_that_has_all_of_its_bytes(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    found = lambda *place: (asked.append(place), (SimpleNamespace(node="uio3"), 2))[1]  # noqa: E731
    monkeypatch.setattr(devices, "find_uio", found)
    window = BoardDevices(opened.root).window(0x120, 64)
    assert (window.device.name, window.map, window.offset) == ("Uio uio3", 2, 0x20)  # type: ignore[attr-defined]
    assert asked == [(0x120, 8, opened.root)]


def test_a_board_without_what_lends_registers_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_: Root) -> Any:
        raise DeviceNotFound(errno.ENOENT, "no node")

    monkeypatch.setattr("cm.device.register_window.Windows.open", none)
    for root, why in (
        (
            Root.of(tmp_path),
            "this simulated board lends no registers: its logic has to see each access \\(--sim=rtl, --sim=bits\\)",
        ),
        (Root.of("/"), "the kernel module cm_window is not loaded \\(modprobe cm_window\\)"),
    ):
        with pytest.raises(NoWindow, match=f"^{why}; they go by requests as before$"):
            BoardDevices(root).windows()


class Gives:
    """A port or channel that gives memory; `log`: what was done."""

    def __init__(self, name: str, log: list[str]) -> None:
        self.name, self.log = name, log

    def allocate(self, length: int) -> Any:
        self.log.append(f"{self.name} gives {length}")
        fd = os.memfd_create("memory")
        return SimpleNamespace(fd=fd, length=8, coherent=True, address=0x1000, close=lambda: self._closed("memory", fd))

    def _closed(self, what: str, fd: int = -1) -> None:
        self.log.append(f"close {what}")
        if fd >= 0:
            os.close(fd)

    def close(self) -> None:
        self._closed(self.name)

    def __enter__(self) -> Gives:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.mark.parametrize(
    ("there", "did", "refused"),
    [
        ({"port": ""}, ["port gives 5", "close memory", "close port"], None),
        ({"a": "busy", "b": "", "c": ""}, ["b gives 5", "close b"], None),
        ({"a": "busy", "b": "busy"}, [], "b is open"),
        ({}, [], "no device of this board gives memory: it has neither a configuration port nor a DMA channel"),
    ],
    ids=lambda given: "+".join(given) if isinstance(given, dict) else "",
)
def test_memory_is_that_of_the_port_or_else_of_a_channel_that_is_free(
    monkeypatch: pytest.MonkeyPatch, there: dict[str, str], did: list[str], refused: str | None
) -> None:
    log, root = list[str](), Root.of("/")

    def open_(name: str, given: Root) -> Gives:
        assert given is root
        if name not in there:
            raise DeviceNotFound(errno.ENOENT, f"no {name}")
        if there[name] == "busy":
            raise DeviceBusy(errno.EBUSY, f"{name} is open")
        return Gives(name, log)

    monkeypatch.setattr(devices, "Icap", SimpleNamespace(open=lambda root: open_("port", root)))
    monkeypatch.setattr(devices, "AxiDma", SimpleNamespace(open=open_))
    monkeypatch.setattr(devices, "list_dma", lambda given: [name for name in there if given is root])
    if refused is not None:
        with pytest.raises((DeviceBusy, NotFound), match=refused):
            BoardDevices(root).memory(5)
    else:
        memory = BoardDevices(root).memory(5)
        assert (memory.length, memory.coherent, memory.address) == (8, True, 0x1000)
        os.fstat(memory.fd)
        memory.free()
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(memory.fd)
    assert log == did


def test_what_the_kernel_says_of_itself(tmp_path: Path) -> None:
    board = BoardDevices(Root.of(tmp_path))
    assert (board.boot_id(), board.root) == ("", tmp_path)
    file = tmp_path / "proc/sys/kernel/random/boot_id"
    file.parent.mkdir(parents=True)
    file.write_text("4f1c\n")
    assert board.boot_id() == "4f1c"


def test_an_fpga_manager_is_known_by_its_number(tmp_path: Path) -> None:
    root = Root.of(tmp_path)
    for number in (0, 12):
        (tmp_path / f"sys/class/fpga_manager/fpga{number}").mkdir(parents=True)
        (tmp_path / f"sys/class/fpga_manager/fpga{number}/name").write_text(str(number))
    assert [BoardDevices(root).fpga_manager(name).name for name in (None, "fpga0", "fpga12")] == ["0", "0", "12"]
    with pytest.raises(DeviceNotFound, match=r"no fpga_manager 'cm_icap0': their names are fpga0, fpga1, …"):
        BoardDevices(root).fpga_manager("cm_icap0")


@pytest.mark.parametrize(
    ("compatible", "states", "assumed", "holds"),
    [
        ("xlnx,zynq-7000", ["unknown"], False, False),
        ("xlnx,zynq-7000", [], False, False),
        ("xlnx,zynqmp", ["unknown", "operating"], False, True),
        ("xlnx,zynq-7000", ["unknown"], True, True),
        ("linux,dummy-virt", [], False, True),  # there is no bus that an empty PL could stall
        (None, [], False, True),
    ],
)
def test_a_zynqs_pl_holds_a_design_if_a_manager_or_the_operator_says_so(
    tmp_path: Path, compatible: str | None, states: list[str], assumed: bool, holds: bool
) -> None:
    if compatible is not None:
        (tmp_path / "proc/device-tree").mkdir(parents=True)
        (tmp_path / "proc/device-tree/compatible").write_text(f"acme,board\0{compatible}\0")
    for number, state in enumerate(states):
        folder = tmp_path / f"sys/class/fpga_manager/fpga{number}"
        folder.mkdir(parents=True)
        (folder / "state").write_text(f"{state}\n")
    assert BoardDevices(Root.of(tmp_path), assumed).holds_design() is holds


# ---- a board that goes, is started anew, or sleeps ------------------------------------------------


class Board:
    """A manager and its board; `log`: what was done about it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.boot_id, self.busy, self.log = "one", False, list[str]()
        self.fails: dict[str, Exception] = {}
        self.slept = 0.0
        monkeypatch.setattr(board_watch, "_asleep", lambda: self.slept)
        streams = SimpleNamespace(close=lambda: self._do("no streams"))
        interrupts = SimpleNamespace(watch=lambda of: self._do(f"watch {of}"), close=lambda: self._do("no interrupts"))
        self.seen, self.state = Seen(), SimpleNamespace(overlays=[SimpleNamespace(name="camera")])
        others = SimpleNamespace(begin=lambda: None, look=self._seen, who=lambda: "dfx-mgrd runs")
        parts: Any = (others, self, streams, interrupts)
        self.watch = BoardWatch(lambda: self.boot_id, *parts, lambda: self._do("begin"))

    def _seen(self, ours: list[str]) -> Seen:
        seen, self.seen = self.seen, Seen()
        return seen

    @property
    def changing(self) -> bool:
        return self.busy

    def status(self) -> Any:
        return SimpleNamespace(fpga_busy=self.busy)

    def loaded_config(self) -> str:
        return "camera"

    def board_restarted(self) -> None:
        self._do("restarted")

    def board_slept(self) -> None:
        self._do("slept")

    def board_taken(self, loads: tuple[str, ...], removed: tuple[str, ...], who: str) -> None:
        self._do(f"taken {loads} {removed} {who}")

    def board_lost(self, error: Exception) -> None:
        self._do(f"lost {error}")

    def _do(self, what: str) -> None:
        self.log.append(what)
        if what in self.fails:
            raise self.fails[what]

    def look(self) -> list[str]:
        self.log.clear()
        self.watch.poll()
        return self.log[:]


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> Board:
    made = Board(monkeypatch)
    made.watch.begin()
    assert made.log == ["watch camera", "begin"]
    return made


ANEW = ["no streams", "no interrupts", "restarted", "begin"]


def test_a_board_that_was_started_anew_is_begun_with_once_it_answers(
    board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "cm")
    assert board.look() == []
    board.boot_id = ""  # it is not there
    assert board.look() == []
    board.boot_id, board.busy = "two", True
    assert board.look() == []
    board.busy, board.fails["restarted"] = False, DeviceGone(errno.ENODEV, "no answer")
    assert [board.look() for _ in range(2)] == [ANEW[:3]] * 2
    assert caplog.messages == ["the board is back but does not answer yet: no answer"] * 2
    board.fails = {"begin": UnknownConfig("no configuration 'camera'")}  # which was removed meanwhile
    assert [board.look() for _ in range(2)] == [ANEW, []]
    assert caplog.messages[2:] == ["the board was restarted, and nothing is loaded: no configuration 'camera'"]


def test_what_was_lost_in_a_sleep_is_seen_to_after_a_change_and_until_it_succeeds(
    board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    board.slept = 0.2
    assert board.look() == []
    board.slept, board.busy = 0.3, True
    assert board.look() == []
    board.busy, board.fails["slept"] = False, DeviceGone(errno.ENODEV, "no answer")
    assert board.look() == ["slept"]
    assert caplog.messages == ["after the machine's sleep: no answer"]
    board.fails = {}
    assert [board.look() for _ in range(2)] == [["slept"], []]


def test_what_others_load_is_seen_to_after_a_change_and_unless_the_board_is_another_one(
    board: Board, caplog: pytest.LogCaptureFixture
) -> None:
    board.seen, board.busy = Seen(("app",), ("camera",)), True
    assert board.look() == []
    board.busy = False
    assert [board.look() for _ in range(2)] == [["taken ('app',) ('camera',) dfx-mgrd runs"], []]
    assert caplog.messages == ["another program: app; camera; dfx-mgrd runs"]
    board.seen, board.boot_id = Seen(("app",)), ""
    assert board.look() == []


def test_only_that_a_board_has_gone_is_passed_on(board: Board) -> None:
    for error in (DeviceNotFound(errno.ENOENT, "none"), UnknownConfig("x"), DeviceGone(errno.ENODEV, "gone")):
        board.log.clear()
        board.watch.notice_error(error)
        assert board.log == (["lost gone"] if isinstance(error, DeviceGone) else [])

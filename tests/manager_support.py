# SPDX-License-Identifier: Apache-2.0
"""A manager in this process on a simulated board, with devices that can be made to fail."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import signal
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cm.device import DeviceError, GpioLine, PlClock, PlClocks, Root
from cm.manager.inputs import Window
from cm.manager.manager import Environment, Manager, Settings
from cm.manager.state.journal import Journal
from cm.schema import loads
from cm.schema.model import Config
from cm.server.bitstream_and_overlay_files import BoardFiles
from cm.server.devices import BoardDevices
from cm.simulation.software import Board as SimBoard
from cm.wire.messages.requests import ChangeMode, CheckRegion
from cm.wire.messages.status import RegValues

CAMERA = Path(__file__).resolve().parents[1] / "cm" / "data" / "camera" / "camera.yaml"


class Clock:
    """The system's clock, which tests may advance, or replace by a clock that only they advance."""

    def __init__(self) -> None:
        self.ahead = 0.0
        self._standing: float | None = None

    def stand_still(self) -> None:
        """Stop it: only `ahead` advances it from now on, so that real time does not matter."""
        self._standing = time.monotonic()

    def monotonic(self) -> float:
        return (time.monotonic() if self._standing is None else self._standing) + self.ahead


class Nobody:
    """A listener and data plane that do nothing but record the calls; `runs` is what streams may run for now."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any]] = []
        self.runs: tuple[str | None, str | None, Mapping[str, str | None]] = None, None, {}

    def status_changed(self) -> None: ...

    def progressed(self) -> None: ...

    def registers_changed(self, values: RegValues) -> None: ...

    def quiesce(self, streams: Collection[str]) -> None:
        self.calls.append(("quiesce", tuple(streams)))

    def resume(self, config: Config | None, mode: str | None, held: Mapping[str, str | None]) -> None:
        self.calls.append(("resume", mode))
        self.runs = config.name if config else None, mode, held

    def wrote(self, generation: int) -> None: ...


@dataclass
class Fault:
    """Fails the operation number `at`, and those after it for `times`; counts all operations."""

    at: int = -1
    times: int = 1
    make: Callable[[str], Exception] = lambda name: DeviceError(errno.EIO, f"injected at {name}")
    names: list[str] = field(default_factory=list)
    watch: Callable[[str], None] = lambda name: None  # called first, in the thread of the operation

    def step(self, name: str) -> None:
        self.watch(name)
        number = len(self.names)
        self.names.append(name)
        if self.at >= 0 and self.at <= number < self.at + self.times:
            raise self.make(name)


class Watched:
    """Passes all calls on, but some of them first to a fault, which may fail them."""

    def __init__(self, inner: Any, fault: Fault, label: str, names: Collection[str]) -> None:
        self._inner, self._fault, self._label, self._names = inner, fault, label, names

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._inner, name)
        if name not in self._names:
            return value

        def call(*args: Any, **kwargs: Any) -> Any:
            self._fault.step(f"{self._label}.{name}")
            return value(*args, **kwargs)

        return call


class WatchedClocks:
    """Clocks whose every access is an operation."""

    def __init__(self, inner: PlClocks, fault: Fault) -> None:
        self._inner, self._fault = inner, fault
        self.names = inner.names

    def find(self, name: str) -> WatchedClock:
        return WatchedClock(self._inner.find(name), self._fault)


class WatchedClock:
    """One of them."""

    def __init__(self, inner: PlClock, fault: Fault) -> None:
        self._inner, self._fault = inner, fault
        self.rounded = inner.rounded

    @property
    def rate(self) -> int:
        self._fault.step("clock.read")
        return self._inner.rate

    @rate.setter
    def rate(self, hertz: int) -> None:
        self._fault.step("clock.write")
        self._inner.rate = hertz

    @property
    def enabled(self) -> bool:
        return self._inner.enabled

    @enabled.setter
    def enabled(self, on: bool) -> None:
        self._fault.step("clock.enable")
        self._inner.enabled = on


class WatchedLine:
    """A line whose every access is an operation."""

    def __init__(self, inner: GpioLine, fault: Fault) -> None:
        self._inner, self._fault = inner, fault

    @property
    def value(self) -> int:
        self._fault.step("gpio.read")
        return self._inner.value

    @value.setter
    def value(self, value: int) -> None:
        self._fault.step("gpio.drive")
        self._inner.value = value


class FaultyDevices:
    """The devices of a board, every operation of which may fail."""

    def __init__(self, inner: BoardDevices, fault: Fault) -> None:
        self._inner, self._fault = inner, fault
        self._ports: dict[Any, Watched] = {}  # an open port is one object

    def boot_id(self) -> str:
        return self._inner.boot_id()

    def holds_design(self) -> bool:
        return self._inner.holds_design()

    def window(self, address: int, width: int) -> Window:
        found = self._inner.window(address, width)
        watched = Watched(found.device, self._fault, "uio", ("read", "write", "read_block", "write_block"))
        return Window(watched, found.map, found.offset)  # type: ignore[arg-type]

    def windows(self) -> Any:
        return Watched(self._inner.windows(), self._fault, "window", ("grant", "revoke", "revoke_grant"))

    def icap(self, name: str | None) -> Any:
        names = ("allocate", "load", "read", "wait", "status")
        port = self._inner.icap(name)
        return self._ports.setdefault(port, Watched(port, self._fault, "icap", names))

    def fpga_manager(self, name: str | None) -> Any:
        return Watched(self._inner.fpga_manager(name), self._fault, "fpga_manager", ("load",))

    def gpio(self, chip: str, line: int | str) -> Any:
        self._fault.step("gpio.open")
        return WatchedLine(self._inner.gpio(chip, line), self._fault)

    def clocks(self) -> Any:
        return WatchedClocks(self._inner.clocks(), self._fault)

    def overlays(self) -> Any:
        return Watched(self._inner.overlays(), self._fault, "overlays", ("apply", "remove"))

    def check(self) -> None:
        self._fault.step("check")
        self._inner.check()

    def forget(self) -> bool:
        return self._inner.forget()

    def lost(self) -> None:
        self._inner.lost()


class FaultyJournal(Journal):
    """A journal whose writes count as operations too."""

    def __init__(self, folder: Path, fault: Fault) -> None:
        super().__init__(folder)
        self.fault = fault

    def write(self, record: Any) -> None:
        self.fault.step("journal.write")
        super().write(record)


@dataclass
class Rig:
    """A manager and what it was given."""

    manager: Manager
    devices: BoardDevices
    given: FaultyDevices  # the same, as the manager has them
    fault: Fault
    data_plane: Nobody
    journal: FaultyJournal
    clock: Clock
    files: BoardFiles
    notes: tuple[str, ...] = ()

    def go(self, mode: str, timeout: float = 30.0, config: str = "camera") -> Any:
        """Go to a mode, or unload ``-REGION``; the error, or None."""
        change = self.manager.submit(asked(config, mode))
        assert change.wait(timeout), f"the change to {mode} did not end"
        return change.error

    def arm(self, at: int, times: int = 1) -> None:
        """Restart counting operations, and fail number `at`."""
        self.fault.names.clear()
        self.fault.at, self.fault.times = at, times

    def close(self) -> None:
        self.manager.stop()
        self.devices.lost()
        self.journal.close()


def asked(config: str, mode: str) -> ChangeMode:
    """The request to go to a mode, or to unload ``-REGION``, or all regions: ``-*``."""
    return ChangeMode(config, unload=mode[1:]) if mode.startswith("-") else ChangeMode(config, mode)


def camera(timeout: float | None = None, defaults: Mapping[str, int] | None = None) -> Config:
    """The shipped example; with a time-out (seconds) for every region's loads, and other defaults of registers."""
    text = CAMERA.read_text(encoding="utf-8")
    for name, value in (defaults or {}).items():
        text, found = re.subn(rf"( {name}:\s[^#]*?default: *)\d+", rf"\g<1>{value}", text, count=1)
        assert found, f"{name} has no default in the camera example"
    config = loads(text, source=CAMERA)
    regions = {name: replace(region, timeout=timeout) for name, region in config.regions.items()}
    return replace(config, regions=regions)


@contextlib.contextmanager
def rig(
    root: Path,
    state: Path,
    *configs: Config,
    prefetch: int = 0,
    files: type[BoardFiles] = BoardFiles,
    new_board: bool = False,
) -> Iterator[Rig]:
    """A started manager on the board under `root`, with the camera example if no configuration is given."""
    made = make_rig(root, state, *configs, files=files, settings=Settings(prefetch, new_board))
    try:
        made.notes = made.manager.start()
        yield made
    finally:
        made.close()


def make_rig(
    root: Path,
    state: Path,
    *configs: Config,
    files: type[BoardFiles] = BoardFiles,
    settings: Settings = Settings(prefetch_bytes=0),  # noqa: B008
) -> Rig:
    """A manager that was not started yet."""
    fault, nobody = Fault(), Nobody()
    devices = BoardDevices(Root.of(root))
    journal = FaultyJournal(state, fault)
    clock, opened = Clock(), files(root)
    faulty = FaultyDevices(devices, fault)
    env = Environment(faulty, opened, journal, nobody, clock, nobody, settings)
    known = {config.name: config for config in configs or (camera(),)}
    return Rig(Manager(known, env), devices, faulty, fault, nobody, journal, clock, opened)


def place_of(made: Rig, sim: SimBoard, configs: Mapping[str, Config]) -> str:
    """The board's mode as config/mode, config/-REGION if one was unloaded, "" for none.

    Manager, streams and board must agree, as far as all is known.
    """
    status, board, held = made.manager.status(), made.manager.state, sim.control.state()
    assert not status.fpga_busy
    assert made.data_plane.runs[1:] == (board.mode, board.modules)
    assert board.mode is None or made.data_plane.runs[0] == board.config
    if board.static_lost:
        assert not status.config_name
        return ""
    for name, region in board.regions.items():
        assert region.phase.value in ("ready", "failed", "unknown") or region.empty, (name, region)
        real = held["regions"][name]
        if region.phase.value == "ready":
            assert (real["module"], real["decoupled"]) == (region.module, False), name
        assert (region.phase.value != "failed" and not region.empty) or real["decoupled"], name
    assert sorted(held["overlays"]) == sorted(o.name for o in board.overlays)
    empty = [name for name, region in board.regions.items() if region.empty]
    if board.config and not board.mode and empty:
        return f"{board.config}/-{'*' if len(empty) == len(configs[board.config].regions) else ','.join(empty)}"
    if not (board.config and board.mode):
        return ""
    config = configs[board.config]
    there = {name: region.module for name, region in board.regions.items() if region.phase.value == "ready"}
    modules = [config.modules[name] for name in config.modes[board.mode].modules]
    return f"{board.config}/{board.mode}" if all(there.get(m.region) == m.name for m in modules) else ""


def killed_at(
    root: Path,
    state: Path,
    configs: Iterable[Config],
    goal: tuple[str, str] | ChangeMode | CheckRegion | None,
    number: int,
) -> bool:
    """Go to `goal` (configuration, mode), or repair a region, in a child process that is killed at an operation.

    Without a goal it only starts, with what it then puts right. False if it survived.
    """
    pid = os.fork()
    if pid == 0:
        try:
            made = make_rig(root, state, *configs)
            made.fault.make = lambda _: os.kill(os.getpid(), signal.SIGKILL)  # type: ignore[assignment,return-value]
            made.arm(number if goal is None else -1)
            made.manager.start()
            made.manager.wait_idle()
            made.arm(number)
            if goal is None:
                os._exit(0)
            if isinstance(goal, CheckRegion):
                made.manager.repair(goal).wait(30.0)
            else:
                made.manager.submit(goal if isinstance(goal, ChangeMode) else asked(*goal)).wait(30.0)
        finally:
            os._exit(0)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])

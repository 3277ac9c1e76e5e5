# SPDX-License-Identifier: Apache-2.0
"""Each call by which a manager writes to its disk fails, once and from there on, or it is killed there or anywhere:
what it tells stays true.
"""

from __future__ import annotations

import errno
import random
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from manager_process import CAMERA, Manager, environment, short_folder, until

import cm
from cm.client.errors import RequestFailed
from cm.errors import CmError
from cm.manager.state.journal import LENGTH
from cm.simulation.software import Board as SimBoard

ERRORS = (errno.ENOSPC, errno.EIO, errno.EDQUOT)
TEXT = (CAMERA / "camera.yaml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def shim(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("shim") / "failing_calls.so"
    source = Path(__file__).with_name("failing_calls.c")
    subprocess.run(["cc", "-shared", "-fPIC", "-Wall", "-Werror", "-o", made, source, "-ldl"], check=True)
    return made


@pytest.fixture(scope="module")
def sim() -> Iterator[SimBoard]:
    with short_folder() as folder, SimBoard([CAMERA], root=folder / "board", arguments=["--icap-rate", "0"]) as board:
        yield board


@dataclass
class Session:
    """A manager with a state folder that holds two configurations that were sent, and what its client was told."""

    sim: SimBoard
    folder: Path
    sent: Path  # files of what is sent
    told: list[tuple[str, str]] = field(default_factory=list)  # steps, and "" or what refused them

    def manager(self, **env: str) -> Manager:
        places = ("--config", str(CAMERA), "--root", str(self.sim.root), "--state-dir", str(self.folder / "state"))
        return Manager(self.folder / "run", *places, env=environment(**env))

    def schema(self, name: str, version: int) -> Path:
        path = self.sent / f"{name}.yaml"
        text = TEXT.replace("name: camera", f"name: {name}", 1).replace("doc: A camera", f"doc: V{version}", 1)
        path.write_text(text, encoding="utf-8")
        return path

    @property
    def files(self) -> list[Path]:
        return sorted(path for path in self.sent.iterdir() if path.suffix != ".yaml")

    def send(self, board: cm.Board, name: str, version: int) -> None:
        board.provision(self.schema(name, version), *self.files)

    def take(self, name: str, step: Callable[[], object]) -> None:
        try:
            step()
        except (CmError, OSError) as error:
            self.told.append((name, f"{getattr(error, 'code', '')}: {error}"))
        else:
            self.told.append((name, ""))

    def steps(self, board: cm.Board) -> None:
        """Thirty of them."""
        for turn, (config, mode) in enumerate(
            [("camera", "default"), ("sent", "edge_detection"), ("camera", "colorise")]
        ):
            for other in (mode, "loopback", mode):
                self.take(f"{config}/{other}", lambda c=config, m=other: board.load(c, m))  # type: ignore[misc]
            for register in ("focus", "led", "scratch"):
                self.take(register, lambda n=register, v=turn + 3: board.registers.write({n: v}))  # type: ignore[misc]
            self.take("sent", lambda v=turn + 2: self.send(board, "sent", v))  # type: ignore[misc]
            self.take("gone", lambda: board.remove_config("gone"))
            self.take("gone again", lambda v=turn + 2: self.send(board, "gone", v))  # type: ignore[misc]
        for mode in ("default", "edge_detection", "default"):
            self.take(f"camera/{mode}", lambda m=mode: board.load("camera", m))  # type: ignore[misc]

    def stored(self, name: str) -> int | None:
        """The version of a configuration that is stored whole; None if there is none."""
        place = self.folder / "state/configs" / name
        if not place.exists():
            return None
        for path in self.files:
            assert (place / path.name).read_bytes() == path.read_bytes(), f"{name}: {path.name}"
        text = (place / "schema.yaml").read_text(encoding="utf-8")
        return int(text[text.index("doc: V") + 6])

    def versions(self, step: str, name: str) -> set[int | None]:
        """Those of `name` that may be stored by what the client was told."""
        may: set[int | None] = {1}
        version = 1
        for told, refused in self.told:
            if told not in (step, name):
                continue
            version += told == step
            new = version if told == step else None
            if not refused:
                may = {new}
            elif "nothing has changed" not in refused and not refused.startswith("unknown_config"):
                may |= {new}
        return may


def truth(sim: SimBoard, status: Any) -> list[str]:
    """Where a status that is at rest says something else than the board holds."""
    held = sim.control.state()["regions"]
    wrong = []
    for region in status.regions:
        there = held[region.name]
        if region.state == "ready" and (there["module"], there["decoupled"]) != (region.module, False):
            wrong.append(f"{region.name} is {region.module}, it holds {there}")
        if region.state == "failed" and not there["decoupled"]:
            wrong.append(f"{region.name} is connected")
    return wrong


def at_rest(board: cm.Board) -> Any:
    until(lambda: not board.status.fpga_busy)
    return board.status


@pytest.fixture
def session(sim: SimBoard, tmp_path: Path) -> Iterator[Session]:
    with short_folder() as folder:
        sent = tmp_path / "sent"
        sent.mkdir()
        for path in (sim.root / "lib/firmware/cm/camera").iterdir():
            if path.suffix in (".bit", ".dtbo"):
                shutil.copy(path, sent)
        made = Session(sim, folder, sent)
        manager = made.manager().start()
        with manager.connected() as board:
            for name in ("sent", "gone"):
                made.send(board, name, 1)
        assert manager.stop() == 0
        shutil.rmtree(folder / "state/journal", ignore_errors=True)
        for name in ("journal", "journal.new"):
            (folder / "state" / name).unlink(missing_ok=True)
        shutil.copytree(folder / "state", folder / "template")
        yield made


def run(session: Session, shim: Path, at: int, number: int, lasting: bool) -> int:
    """A session in which a call fails; returns how many calls there were. Raises where something is not as told."""
    shutil.rmtree(session.folder / "state")
    shutil.copytree(session.folder / "template", session.folder / "state")
    session.told.clear()
    session.sim.control.reset()
    log = session.folder / "calls"
    log.unlink(missing_ok=True)
    more = {"FAIL_LASTING": "1"} if lasting else {}
    places = {"LD_PRELOAD": str(shim), "FAIL_BELOW": f"{session.folder}/state/", "FAIL_LOG": str(log)}
    manager = session.manager(FAIL_AT=str(at), FAIL_ERRNO=str(number), **places, **more).start()
    with manager.connected() as board:
        board.timeout = 30.0
        session.steps(board)
        told = at_rest(board)
        assert truth(session.sim, told) == [], "as it was told at the end"
        values = {name: board.registers[name] for name in ("focus", "led", "scratch")} if told.mode else {}
    assert manager.stop() == 0, manager.log.decode()
    again = session.manager().start()
    try:
        with again.connected() as board:
            status = at_rest(board)
            assert truth(session.sim, status) == [], "after a restart"
            if told.mode:
                assert (status.config_name, status.mode) == (told.config_name, told.mode)
                assert {name: board.registers[name] for name in values} == values
            for step, name in (("sent", ""), ("gone again", "gone")):
                config = step.split()[0]
                assert session.stored(config) in session.versions(step, name)
                assert (config in status.configs) == (session.stored(config) is not None)
            session.send(board, "sent", 9)
            board.load("sent", "default")
            assert truth(session.sim, at_rest(board)) == []
    finally:
        assert again.stop() == 0
    return len(log.read_text(encoding="utf-8").splitlines())


@pytest.mark.timeout(36000)
def test_whatever_call_fails_what_is_told_is_what_the_board_and_the_disk_hold(
    session: Session, shim: Path, request: pytest.FixtureRequest
) -> None:
    calls = run(session, shim, 0, 0, lasting=False)
    assert all(not refused for _, refused in session.told), session.told
    assert len(session.told) == 30
    ways = [(at, number, lasting) for at in range(1, calls + 1) for number in ERRORS for lasting in (False, True)]
    most = request.config.getoption("--failing")
    for at, number, lasting in random.Random(59).sample(ways, min(most, len(ways))) if most else ways:
        said = f"call {at} of {calls}, {errno.errorcode[number]}{' from there on' if lasting else ''}"
        try:
            run(session, shim, at, number, lasting)
        except Exception as error:
            raise AssertionError(f"{said}: {error}; {[step for step in session.told if step[1]]}") from error


@dataclass
class Told:
    """What a client knows of a board at rest: what was confirmed, beside what it has asked for and was not told."""

    place: set[tuple[str, str]] = field(default_factory=set)  # configuration and mode
    registers: dict[str, set[int]] = field(default_factory=dict)  # in the place that was confirmed
    stored: dict[str, set[int | None]] = field(default_factory=dict)  # versions
    asked: list[str] = field(default_factory=list)  # in this order

    def load(self, board: cm.Board, config: str, mode: str) -> None:
        self.asked.append(f"load {config}/{mode}")
        self.place.add((config, mode))
        self.registers.clear()  # they are what the mode sets, also where it is loaded again
        board.load(config, mode)
        self.place = {(config, mode)}
        self.look(board)

    def look(self, board: cm.Board) -> None:
        self.registers = {name: {board.registers[name]} for name in ("focus", "led", "scratch")}

    def write(self, board: cm.Board, name: str, value: int) -> None:
        self.asked.append(f"{name}={value}")
        self.registers[name].add(value)
        board.registers[name] = value
        self.registers[name] = {value}

    def send(self, session: Session, board: cm.Board, name: str, version: int) -> None:
        self.asked.append(f"send {name} {version}")
        self.stored[name].add(version)
        session.send(board, name, version)
        self.stored[name] = {version}

    def remove(self, board: cm.Board, name: str) -> None:
        self.asked.append(f"remove {name}")
        self.stored[name].add(None)
        try:
            board.remove_config(name)
        except RequestFailed as refused:
            if refused.code != "unknown_config":
                raise
        self.stored[name] = {None}

    def differences(self, session: Session, board: cm.Board) -> list[str]:
        """From what a manager that was started again says, and the board and the disk hold."""
        status = at_rest(board)
        wrong = truth(session.sim, status)
        if (status.config_name, status.mode) not in self.place:
            wrong.append(f"{status.config_name}/{status.mode} is none of {self.place}")
        if len(self.place) == 1:
            now = {name: board.registers[name] for name in self.registers}
            wrong += [f"{n} is {now[n]:#x}, none of {may}" for n, may in self.registers.items() if now[n] not in may]
        for name, may in self.stored.items():
            there = session.stored(name)
            if there not in may or (name in status.configs) != (there is not None):
                wrong.append(f"{name}: version {there} is stored, none of {may}; told are {status.configs}")
        return wrong


def busy(session: Session, told: Told, board: cm.Board, draw: random.Random) -> None:
    """Ask for one thing after the other, until nobody answers any more."""
    for version in range(2, 10):
        deed = draw.choice(("load", "load", "write", "write", "write", "send", "remove"))
        if deed == "load":
            mode = draw.choice(("default", "edge_detection", "colorise", "loopback"))
            told.load(board, draw.choice(("camera", "sent")), mode)
        elif deed == "write":
            told.write(board, draw.choice(tuple(told.registers)), draw.randrange(8))
        elif deed == "send":
            told.send(session, board, draw.choice(("sent", "gone")), version)
        else:
            told.remove(board, "gone")


def turn_soon(journal: Path, draw: random.Random) -> None:
    """Write a journal's last line again and again, until it has room for a few: then it turns over."""
    data = journal.read_bytes().rstrip(b"\0")
    line = b"\n" + data.split(b"\n")[-2] + b"\n"
    room = LENGTH - len(data) - draw.randrange(12) * len(line)
    journal.write_bytes((data + max(0, room // len(line)) * line).ljust(LENGTH, b"\0"))


@pytest.mark.timeout(36000)
def test_whenever_it_is_killed_what_was_told_is_what_the_board_and_the_disk_hold(
    session: Session, shim: Path, request: pytest.FixtureRequest
) -> None:
    draw = random.Random(request.config.getoption("--kill-seed"))
    told = Told(stored={"sent": {1}, "gone": {1}})
    turns = 0
    manager = session.manager().start()
    with manager.connected() as board:
        told.load(board, "camera", "default")
    for number in range(request.config.getoption("--kills")):
        manager.kill()
        if draw.random() < 0.5:
            turn_soon(session.folder / "state/journal", draw)
        before = (session.folder / "state/journal").stat().st_ino
        by_call = draw.choice((0, draw.randrange(1, 60)))
        places = {"LD_PRELOAD": str(shim), "FAIL_BELOW": f"{session.folder}/state/", "FAIL_ERRNO": "0"}
        manager = session.manager(FAIL_AT=str(by_call), **places)
        errors = killed_amid(manager, session, told, draw, 0.0 if by_call else draw.uniform(0.01, 0.6))
        turns += (session.folder / "state/journal").stat().st_ino != before
        manager = session.manager().start()
        with manager.connected() as board:
            wrong = told.differences(session, board)
            assert (wrong, errors) == ([], []), f"round {number}, call {by_call}: {told.asked}; {manager.log.decode()}"
            told.asked.clear()
            status = board.status
            told.place = {(status.config_name, status.mode)}
            told.look(board)
            told.stored = {name: {session.stored(name)} for name in told.stored}
    assert manager.stop() == 0
    assert turns > request.config.getoption("--kills") // 20


def killed_amid(manager: Manager, session: Session, told: Told, draw: random.Random, seconds: float) -> list[str]:
    """Let a client be busy with a manager that is killed: after some time, where it kills itself, or at the end.

    Returns what else went wrong.
    """
    errors: list[str] = []
    try:
        manager.start()
    except AssertionError:  # killed so early
        manager._reap()
        return errors

    def client() -> None:
        try:
            with cm.connect(runtime_dir=manager.runtime, timeout=20) as board:
                at_rest(board)
                busy(session, told, board, draw)
        except RequestFailed as error:
            errors.append(f"{error.code}: {error}")
        except (CmError, OSError):
            pass  # nobody answers any more

    thread = threading.Thread(target=client)
    thread.start()
    if seconds:
        time.sleep(seconds)  # anywhere in it
        assert manager.process is not None
        manager.process.kill()
    thread.join()
    manager.kill()
    return errors

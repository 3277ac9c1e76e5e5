# SPDX-License-Identifier: Apache-2.0
"""A board that runs, as tests on the host see it: programs on it, its ports, its mains switch."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from vmboard import qemu
from vmboard.agent import Agent, Done
from vmboard.errors import VmError
from vmboard.shell import run

BOOT_S = 50.0  # until the agent answers, times the board's slowness
COMMAND_S = 30.0  # for a program, times the board's slowness


def _line(command: str, user: str) -> list[str]:
    return ["/bin/sh", "-c", command] if user == "root" else ["/sbin/runuser", "-l", user, "-c", command]


def _socket_folder() -> Path:
    """A folder of a short name, as paths of sockets must be; those of runs that were killed go."""
    for left in Path(tempfile.gettempdir()).glob("cm-vm-*-*"):
        if not Path("/proc", left.name.split("-")[2]).exists():
            shutil.rmtree(left, ignore_errors=True)
    return Path(tempfile.mkdtemp(prefix=f"cm-vm-{os.getpid()}-"))


class Booted:
    """A board with systemd; its root disk keeps what it writes."""

    def __init__(self, machine: qemu.Machine, place: Path) -> None:
        self._place = place
        self._sockets = _socket_folder()
        self.machine = dataclasses.replace(machine, agent=self._sockets / "agent", keep=True)
        self._boots = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._agent: Agent | None = None

    @property
    def console(self) -> Path:
        """What the kernel said since the last boot."""
        return self._place / f"boot-{self._boots}" / "console.log"

    def boot(self, *arguments: str) -> None:
        """Switch it on, with more arguments of the kernel, and wait until programs can be run."""
        self._boots += 1
        folder = self.console.parent
        folder.mkdir(parents=True)
        machine = dataclasses.replace(self.machine, arguments=(*self.machine.arguments, *arguments))
        with (folder / "qemu.log").open("wb") as log:
            self._process = subprocess.Popen(
                qemu.logged(machine, folder), stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        self._agent = self._connect(time.monotonic() + BOOT_S * machine.slow)

    def _connect(self, deadline: float) -> Agent:
        agent = None
        while time.monotonic() < deadline:
            if self._process is None or self._process.poll() is not None:
                raise VmError(f"QEMU ended, see {self.console.parent}")
            if agent is None and self.machine.agent is not None and self.machine.agent.exists():
                agent = Agent(self.machine.agent)
            if agent is None:
                time.sleep(0.2)
            elif agent.answers(2.0):
                return agent
        end = "\n".join(self.console.read_text(errors="replace").splitlines()[-20:])
        raise VmError(f"the board did not start, see {self.console}:\n{end}")

    def run(self, command: str, user: str = "root", given: str = "", patience_s: float = 0) -> Done:
        """A shell's command line, as a user who has just logged in; `patience_s` is for what takes very long."""
        return self._running.run(_line(command, user), patience_s or COMMAND_S * self.machine.slow, given)

    def begin(self, command: str, user: str = "root", given: str = "") -> Callable[[], Done]:
        """The same beside what follows; the result waits for its end."""
        agent, patience_s = self._running, COMMAND_S * self.machine.slow
        program = agent.begin(_line(command, user), patience_s, given)
        return lambda: agent.end(program, patience_s)

    @property
    def _running(self) -> Agent:
        if self._agent is None:
            raise VmError("the board is switched off")
        return self._agent

    def do(self, command: str, user: str = "root", given: str = "", patience_s: float = 0) -> str:
        """The same where an error is a failure; what the command wrote to its standard output."""
        done = self.run(command, user, given, patience_s)
        if done.status:
            raise VmError(f"{user}: {command}: status {done.status}\n{done.said}")
        return done.out

    def twin(self, place: Path, forwards: dict[int, int]) -> Booted:
        """Another board, switched off, with the disk that this one would have if its power went now."""
        if self._process is None:
            raise VmError("the board is switched off")
        place.mkdir(parents=True)
        self._process.send_signal(signal.SIGSTOP)
        try:
            run(["cp", "--reflink=auto", "--sparse=always", self.machine.root, place / "root.ext4"])
        finally:
            self._process.send_signal(signal.SIGCONT)
        return Booted(dataclasses.replace(self.machine, root=place / "root.ext4", forwards=forwards), place)

    def cut_power(self) -> None:
        """End QEMU without a word to the board: what its kernel had not written is lost."""
        if self._agent is not None:
            self._agent.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._agent = self._process = None
        (self._sockets / "agent").unlink(missing_ok=True)  # the next QEMU makes its own

    def close(self) -> None:
        """Switch it off for good."""
        self.cut_power()
        shutil.rmtree(self._sockets, ignore_errors=True)

    def shut_down(self) -> None:
        """Switch it off in order, so that its disk is clean."""
        if self._process is None:
            return
        self.begin("systemctl --no-block poweroff")  # the board may be off before its end could be asked for
        try:
            self._process.wait(COMMAND_S * self.machine.slow)
        finally:
            self.cut_power()

# SPDX-License-Identifier: Apache-2.0
"""`Board`: a simulator as a child process, for tests and for `cm serve --sim`; or one that was taken over."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import time
from collections.abc import Iterable
from pathlib import Path

from cm.child import command, environment
from cm.simulation.software.errors import SimError
from cm.simulation.software.process.control import Control
from cm.simulation.software.transport.scratch import Scratch


class Child:
    """A process that we have started."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    @property
    def pid(self) -> int:
        """Its number."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def send(self, number: int) -> None:
        """Send a signal."""
        self._process.send_signal(number)

    def wait(self, timeout: float) -> int:
        """Its exit status."""
        status = self._process.wait(timeout)
        if self._process.stdout is not None:
            self._process.stdout.close()
        return status


class Adopted:
    """A process whose parent has died."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._fd = os.pidfd_open(pid)

    @property
    def pid(self) -> int:
        """Its number."""
        return self._pid

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return not self._ended(0.0)

    def send(self, number: int) -> None:
        """Send a signal."""
        if self._fd >= 0:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._fd, number)

    def wait(self, timeout: float) -> int:
        """Wait for its end; only its parent learns the status."""
        if not self._ended(timeout):
            raise subprocess.TimeoutExpired("cm sim", timeout)
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
        return 0

    def _ended(self, timeout: float) -> bool:
        return self._fd < 0 or bool(select.select([self._fd], [], [], timeout)[0])


_PREFIX = "cm-sim-"
LINGER = 5.0


class Board:
    """A simulated board; started by entering it, gone when it is left.

    `configs` are schema files or folders of them. Without `root` a folder in memory is made, and
    removed at the end whatever happened to the process. If this process dies, the board ends by
    itself when no client has used it for five seconds. `program` is the module that is run, since others can serve
    the same nodes (`cm.simulation.rtl`).
    """

    def __init__(
        self,
        configs: Iterable[Path | str] | Path | str = (),
        root: Path | str | None = None,
        arguments: Iterable[str] = (),
        timeout: float = 60.0,
        program: str = "cm.simulation.software",
    ) -> None:
        given = [configs] if isinstance(configs, (str, Path)) else configs  # the letters of a path are no paths
        self._configs = [str(path) for path in given]
        self._owner = os.getpid()
        self._arguments = list(arguments)
        self._timeout = timeout
        self._program = program
        self._own_root = None if root is not None else Scratch(_PREFIX)
        self.root = self._own_root.path if self._own_root is not None else Path(root or "")
        self.control = Control(self.root)
        self._process: Child | Adopted | None = None

    @property
    def pid(self) -> int:
        """Of the simulator's process."""
        return self._running().pid

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.alive

    def start(self) -> Board:
        """Start the process and wait until its nodes are there.

        If a simulator whose owner has died serves the root already, it is taken over with all its state if it was
        started with the same arguments, otherwise stopped first.

        Raises:
            SimError: it ended instead, with what it said, or did not become ready in time.
        """
        self._process = self._take_over() or self._spawn()
        return self

    def stop(self, timeout: float = 10.0) -> int:
        """End it as SIGTERM does; its exit status."""
        return self._end(signal.SIGTERM, timeout)

    def kill(self) -> None:
        """End it as a crash does: nothing is cleaned up, the root stays."""
        self._end(signal.SIGKILL, 10.0)

    def restart(self) -> Board:
        """Start it again on the same root."""
        return self.start()

    def close(self) -> None:
        """Stop it if it runs, and remove a root that was made here; in a process that was forked, leave it as it is."""
        if os.getpid() != self._owner:
            return
        if self._process is not None:
            try:
                self.stop()
            except subprocess.TimeoutExpired:
                self.kill()
        if self._own_root is not None:
            self._own_root.close()

    def __enter__(self) -> Board:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _running(self) -> Child | Adopted:
        if self._process is None:
            raise SimError("the board was not started, or has been stopped")
        return self._process

    def _end(self, number: int, timeout: float) -> int:
        process = self._running()
        process.send(number)
        status = process.wait(timeout)
        self._process = None
        return status

    @property
    def _command(self) -> list[str]:
        options = ["--root", str(self.root), "--linger", str(LINGER)]
        for path in self._configs:
            options += ["--config", path]
        return [*options, *self._arguments]

    def _take_over(self) -> Adopted | None:
        try:
            self.control.adopt()
            state = self.control.state()
            found = Adopted(state["pid"])
        except (SimError, OSError):
            return None
        if state["arguments"] == self._command:
            return found
        found.send(signal.SIGTERM)
        found.wait(self._timeout)
        return None

    def _spawn(self) -> Child:
        process = subprocess.Popen(
            command(self._program, *self._command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            env=environment(),
            start_new_session=True,  # Ctrl-C is for whoever uses the board, who ends it afterwards
        )
        try:
            self._await_ready(process)
        except BaseException:
            process.kill()
            process.communicate()
            if self._own_root is not None:
                self._own_root.close()
            raise
        return Child(process)

    def _await_ready(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        fd = process.stdout.fileno()
        deadline = time.monotonic() + self._timeout
        line = b""
        while not line.endswith(b"\n"):
            ready, _, _ = select.select([fd], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise SimError(f"the simulator was not ready after {self._timeout:g} s")
            piece = os.read(fd, 4096)
            if not piece:
                raise SimError(f"the simulator ended with status {process.wait(self._timeout)} before it was ready")
            line += piece
        said = {}
        with contextlib.suppress(ValueError):
            said = json.loads(line)
        if not said.get("ready"):
            raise SimError(said.get("error") or f"the simulator said {line!r} instead of being ready")

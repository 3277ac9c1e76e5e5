# SPDX-License-Identifier: Apache-2.0
"""A manager on a simulated board as a child process, for as long as tests need it."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from cm import child
from cm.client.board import Board, connect
from cm.errors import CmError
from cm.simulation.software import Control

START_TIMEOUT = 300.0  # seconds: HDL may have to be compiled
PATIENCE = "60"  # seconds for an answer of the simulated board: a machine that runs tests may be busy


class NotServed(CmError):
    """The manager did not start; the text is what it said."""

    code = "not_served"


class Served:
    """`cm serve --sim` in a folder of its own, which is deleted with it."""

    def __init__(self, kind: str, configs: tuple[str, ...] = (), build: str = "") -> None:
        """`kind`: models or rtl. Raises NotServed."""
        self._folder = Path(tempfile.mkdtemp(prefix="cm-test-"))
        self.runtime = self._folder / "run"
        arguments = [f"--sim={kind}", "--runtime-dir", str(self.runtime), "--sim-hold", "0"]
        for path in configs:
            arguments += ["--config", path]
        arguments += ["--build", build] if build else []
        self._process = subprocess.Popen(
            child.command("cm.cli.main", "serve", *arguments), stdin=subprocess.DEVNULL, stderr=subprocess.PIPE,
            env={"CM_SIM_TIMEOUT": PATIENCE} | child.environment(), start_new_session=True,
        )  # fmt: skip
        try:
            self._await_ready()
        except BaseException:
            self.stop()
            raise

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    @property
    def control(self) -> Control:
        """Of the simulated board."""
        return Control(self.runtime / "board")

    def begin(self, load: str) -> None:
        """Put the board into the state after power-up, and load `load` ("CONFIG[/MODE]"; empty: what there is).

        Leases that the test before has left are broken.
        """
        self.control.clear()
        with connect(str(self.runtime), timeout=60.0) as board:
            for lease in board.status.leases:
                board.break_lease(lease.number)
            config, _, mode = load.partition("/")
            config = config or self._only(board)
            board.load(config, mode, progress=False, force=True)

    def stop(self) -> None:
        """End it; twice is fine."""
        child.ended(self._process)
        if self._process.stderr is not None:
            self._process.stderr.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    @staticmethod
    def _only(board: Board) -> str:
        names = sorted(board.configs)
        if len(names) != 1:
            raise NotServed(f"there are {len(names)} configurations ({', '.join(names)}): say cm_load = NAME[/MODE]")
        return names[0]

    def _await_ready(self) -> None:
        ready, said = child.said_until(self._process, b"ready at", START_TIMEOUT)
        if not ready:
            raise NotServed(f"the manager did not start: {said.decode(errors='replace').strip()}")

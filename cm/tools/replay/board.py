# SPDX-License-Identifier: Apache-2.0
"""A simulated board and its manager, put into the state in which a record begins."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

from cm import child
from cm.client.board import Board, connect
from cm.client.core import calls
from cm.errors import CmError, InvalidRequest
from cm.frozen import dataclass
from cm.simulation.software import Control
from cm.tools.replay.script import Fault, Script, fault_of, needs_fault
from cm.wire.messages.status import PastChange, Status

_PATIENCE = 300.0  # seconds: HDL may have to be compiled first


@dataclass(frozen=True, slots=True)
class Bench:
    """A manager, a client of it, and the control of its board."""

    board: Board
    control: Control
    folder: Path

    def history(self) -> Status:
        """The status, with changes and writes."""
        return self.board.ask(calls.history())


@contextlib.contextmanager
def bench(
    script: Script, folder: Path | None = None, against: str = "sim", build: Path | None = None
) -> Iterator[Bench]:
    """A manager on a simulated board under a runtime folder (None: a fresh one), where the record begins.

    `against`: sim, or rtl with the build schema of the design. Raises InvalidRequest, and what the manager refuses.
    """
    with tempfile.TemporaryDirectory(prefix="cm-replay-") as fresh, contextlib.ExitStack() as stack:
        runtime, schemas = folder or Path(fresh) / "run", Path(fresh) / "schemas"
        schemas.mkdir()
        for name, text in script.schemas.items():
            (schemas / f"{name}.yaml").write_text(text, encoding="utf-8")
        words = ["serve", "--runtime-dir", str(runtime), "--state-dir", str(Path(fresh) / "state")]
        if against == "rtl":
            words += ["--sim=rtl", *(["--build", str(build)] if build else [])]
        else:
            if not script.schemas:
                raise InvalidRequest("the record has no configuration, so there is nothing to run again")
            words += ["--sim", "--config", str(schemas)]
        process = _started(words)
        stack.callback(child.ended, process)
        board = stack.enter_context(connect(runtime_dir=runtime))
        made = Bench(board, Control(runtime / "board"), runtime)
        _go_to(made, script)
        yield made


def _started(words: list[str]) -> subprocess.Popen[bytes]:
    """The manager, once it serves. Raises InvalidRequest with what it has said."""
    process = subprocess.Popen(
        child.command("cm.cli.main", *words), stderr=subprocess.PIPE, env=child.environment(), start_new_session=True
    )
    there, said = child.said_until(process, b"ready at", _PATIENCE)
    if not there:
        child.ended(process)
        raise InvalidRequest(f"the manager of the replay did not start: {said.decode(errors='replace').strip()[-500:]}")
    threading.Thread(target=_drain, args=(process,), daemon=True).start()
    return process


def _drain(process: subprocess.Popen[bytes]) -> None:
    assert process.stderr is not None
    with process.stderr as pipe, contextlib.suppress(OSError, ValueError):
        while pipe.read(4096):
            pass


def _go_to(made: Bench, script: Script) -> None:
    """Load what was loaded, with the values that the registers held."""
    first = script.first
    if not first.config_name or not first.mode:
        return
    made.board.load(first.config_name, first.mode)
    info = made.board.config()
    for register in info.registers:
        value = script.values.get(register.name)
        if value is None:
            continue
        if register.access == "rw" and not register.fields:
            with contextlib.suppress(CmError):  # not in this mode; or what was read cannot be written, and is put there
                made.board.registers.write({register.name: value})
                continue
        with contextlib.suppress(CmError):
            made.control.register(register.name, value)


class Faults:
    """The faults that make the record's changes fail as they did, ordered before the first of them begins.

    Each strikes once so many loads have ended as had in the record, so nobody has to be quick.
    """

    def __init__(self, made: Bench, script: Script, repairs: bool = True) -> None:
        """`repairs`: those of the record are made too, and load something."""
        self._control, self._left = made.control, list(script.changes)
        kinds = ("load", "load_full", "repair") if repairs else ("load", "load_full")
        loads = 0
        for change in script.changes:
            failed = [at for at, step in enumerate(change.steps) if step.failed]
            before = sum(step.kind in kinds for step in change.steps[: failed[0]]) if failed else 0
            fault = _fault(change)
            if fault is not None:
                count = max(1, sum(change.steps[at].kind in kinds for at in failed))
                late = fault.kind == "fpga_manager_error"  # it is looked for when the load has ended
                self._control.inject(fault.kind, fault.target or None, count, after=loads + before + late)
            loads += sum(step.kind in kinds for step in change.steps)

    def upset(self, region: str) -> None:
        """Turn over a bit of a region that the record's next change found wrong, and repaired."""
        if self._left and any(step.kind in ("repair", "load") for step in self._left[0].steps):
            self._control.upset(region)

    def next(self) -> None:
        """A change has ended: a fault of it that lasts is over."""
        fault = _fault(self._left.pop(0)) if self._left else None
        if fault is not None and fault.lasting:
            with contextlib.suppress(CmError):
                self._control.clear(fault.kind, fault.target or None)


def _fault(change: PastChange) -> Fault | None:
    return fault_of(change) if needs_fault(change) else None

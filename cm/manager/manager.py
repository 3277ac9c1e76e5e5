# SPDX-License-Identifier: Apache-2.0
"""The manager: configurations, the state of the board, changes one after the other, registers by name.

Threads: requests come from one thread (the daemon's loop); one worker thread runs changes. The state is
an immutable value that is swapped; `_access` keeps register accesses of requests and the moments at
which a change takes regions away from overlapping.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from cm.errors import CmError
from cm.manager import resolve
from cm.manager.changes import Change, ChangeRunner
from cm.manager.cost import Throughput
from cm.manager.describe import config_info, region_states
from cm.manager.desk import Locked, RegisterDesk
from cm.manager.errors import Cancelled, ChangeBusy, NothingLoaded, StoreCorrupt
from cm.manager.leases import Leases, leases_concerned
from cm.manager.loaders import Job, Loaders
from cm.manager.plan import Goal
from cm.manager.ports import Clock, DataPlane, Devices, Files, Observer
from cm.manager.reconcile import reconcile
from cm.manager.registers import RegisterAccess
from cm.manager.state import BoardState, RegionPhase
from cm.manager.steps import ApplyOverlay, RemoveOverlay, Step
from cm.manager.store import Pending, Record, Store
from cm.manager.transaction import Tools
from cm.messages.requests import RegWrite, WriteConfig
from cm.messages.status import ConfigInfo, ErrorInfo, PlanInfo, PrMode, Progress, RegValues, Status
from cm.schema.model import Config, ConfigType, LoaderKind

QUEUE_LENGTH = 8


@dataclass(frozen=True, slots=True)
class Settings:
    """What an operator may set."""

    prefetch_bytes: int = 64 << 20  # DMA memory that images of the loaded configuration may take


@dataclass(frozen=True, slots=True)
class Environment:
    """Everything the manager is given."""

    devices: Devices
    files: Files
    store: Store
    data_plane: DataPlane
    clock: Clock
    observer: Observer
    settings: Settings = Settings()


class Manager:
    """One per board. `start()` reconciles and starts the worker; `stop()` ends it between two changes."""

    def __init__(self, configs: Mapping[str, Config], env: Environment) -> None:
        self.configs: Mapping[str, Config] = MappingProxyType(dict(configs))  # all that can be loaded
        self._env = env
        self.throughput = Throughput()
        self.registers = RegisterAccess(env.devices)
        self.leases = Leases(env.clock)
        self._loaders = Loaders(env.devices, env.files, env.clock, env.settings.prefetch_bytes)
        tools = Tools(env.devices, self.registers, self._loaders, env.data_plane, env.clock)
        self._runner = ChangeRunner(self, tools, env.files, lambda: self.configs, lambda: self.throughput)
        self._access = threading.RLock()
        self._desk = RegisterDesk(self, self.registers, self.leases, self._access)
        self.read_registers = self._desk.read
        self._queue: queue.Queue[Change | None] = queue.Queue(QUEUE_LENGTH)
        self._worker = threading.Thread(target=self._work, name="cm-changes", daemon=True)
        self.state = BoardState()  # what the board holds, as far as is known; replaced by `update`
        self._boot_id = ""
        self._progress: Progress | None = None
        self._running: Change | None = None
        self._pending: Pending | None = None
        self._error: ErrorInfo | None = None
        self._failed = False
        self._full = False  # the running change loads a whole image
        self._number = 0
        self._stopping = threading.Event()
        self._last: tuple[int, float] = (0, 0.0)
        self._dirty = False

    # ---- life -------------------------------------------------------------------

    def start(self) -> tuple[str, ...]:
        """Find out what the board holds; returns what was noticed, in sentences. Raises DeviceError.

        A change that was cut short is undone: the board goes back to the mode before it, as a change
        of its own that the worker runs first.
        """
        notes = self.reconcile()
        self._worker.start()
        return notes

    def reconcile(self) -> tuple[str, ...]:
        """Compare record and board (again). Called before the worker starts, or when it is idle."""
        record, lost = self._read_record()
        finding = reconcile(record, self.configs, self._env.devices, self.registers)
        if lost:
            finding = replace(finding, notes=(lost, *finding.notes))
        self.state, self._boot_id = finding.state, self._env.devices.boot_id()
        if record is not None:
            self.throughput, self._number = record.throughput, record.number
        if finding.notes:
            self._error = ErrorInfo("reconciled", "; ".join(finding.notes))
        self._repair(interrupted=finding.interrupted)
        self._env.data_plane.resume(self.loaded_config(), self.state.mode)
        self.record(None)
        self._env.observer.status_changed()
        return finding.notes

    def _read_record(self) -> tuple[Record | None, str]:
        """The record, and a sentence where it was not readable: then nothing is known, which is no reason to stop."""
        try:
            return self._env.store.read(), ""
        except StoreCorrupt as error:
            return None, str(error)

    def _repair(self, interrupted: Pending | None) -> None:
        """Queue what brings the board back to a whole mode, where it is not in one."""
        config, mode = self.loaded_config(), self.state.mode
        static = None
        if interrupted is not None and config is None:  # cut short after the device was given another image
            config, mode, static = self._way_back(interrupted)
        if config is None or mode is None or mode not in config.modes:
            self.update(lambda state: replace(state, config=None, mode=None))
            return
        regions = {config.modules[m].region for m in config.modes[mode].modules}
        whole = all(self.state.region(r).phase is RegionPhase.READY for r in regions)
        if interrupted is not None or not whole:
            self._enqueue(Change(self._next_number(), config.name, mode, static=static))

    def _way_back(self, cut: Pending) -> tuple[Config | None, str | None, str | None]:
        """Configuration, mode, and the image to load first; no configuration where that image is not ours to load."""
        config = self.configs.get(cut.from_config or "")
        full = config is not None and config.type is ConfigType.FULL
        if full or cut.from_static in self.configs:
            return config, cut.from_mode, None if full else cut.from_static
        return None, None, None

    def board_restarted(self) -> None:
        """The board was started anew: nothing that is recorded is true any more. Raises DeviceError."""
        self._loaders.forget()
        self.registers.forget(lost=True)
        self.reconcile()

    def stop(self) -> None:
        """End after the running change; queued ones are refused as cancelled."""
        self._stopping.set()
        if self._worker.is_alive():
            self._queue.put(None)
            self._worker.join()
        self._loaders.forget()
        self.flush()

    # ---- configurations and changes -----------------------------------------------

    def add_config(self, config: Config) -> None:
        """Make a configuration known (again). Raises ChangeBusy while it is being changed to."""
        self.check_replaceable(config.name)
        self._env.files.forget(config.name)
        self.configs = MappingProxyType({**self.configs, config.name: config})
        if self.state.config == config.name and self.state.mode not in config.modes:
            self.update(lambda state: replace(state, mode=None))  # it is in none of the modes that there are now
        if self.state.config == config.name and not self._busy():
            self._env.data_plane.resume(config, self.state.mode)
        self._env.observer.status_changed()

    def check_replaceable(self, name: str) -> None:
        """Raise ChangeBusy while a configuration is being changed to: its files are in use."""
        running = self._running
        if running is not None and running.config == name:
            raise ChangeBusy(f"configuration {name!r} is being loaded; provision it when the change has ended")

    def loaded_config(self) -> Config | None:
        """The configuration that is loaded."""
        return self.configs.get(self.state.config) if self.state.config else None

    def submit(self, request: WriteConfig, on_done: Callable[[Change], None] | None = None) -> Change:
        """Accept a change; it runs when those before it have ended. Nothing is touched if this raises.

        `on_done` is called at its end, from the worker's thread.
        """
        config, mode = resolve.target(request, self.configs, self.state.config)
        scopes = leases_concerned(config, mode, self.state.config)
        self.leases.check(scopes, request.lease)
        if request.no_queue and self._busy():
            raise ChangeBusy(f"a change to {self._target_text()} is running")
        number = self._next_number()
        return self._enqueue(
            Change(number, config.name, mode, request.force, None, scopes, request.lease, on_done=on_done)
        )

    def wait_idle(self) -> None:
        """Wait until no change runs or waits."""
        self._queue.join()

    def cancel(self) -> bool:
        """Cancel the running change, if there is one."""
        running = self._running
        if running is not None:
            running.cancel()
        return running is not None

    def plan(self, request: WriteConfig) -> PlanInfo:
        """What a change would do; touches nothing, but reads and validates all files."""
        config, mode = resolve.target(request, self.configs, self.state.config)
        return self._runner.plan(Goal(config, mode, request.force)).info(self.throughput)

    def describe(self, name: str, counts: Mapping[str, int]) -> ConfigInfo:
        """A configuration, with its schema's text; the loaded one if `name` is empty."""
        if not name and self.state.config is None:
            raise NothingLoaded("nothing is loaded: name a configuration")
        config = resolve.config_named(name or self.state.config or "", self.configs)
        mode = self.state.mode if self.state.config == config.name else ""
        text = config.source.read_text(encoding="utf-8") if config.source and config.source.exists() else ""
        return config_info(config, mode or "", counts, text)

    def _next_number(self) -> int:
        self._number += 1
        return self._number

    def _busy(self) -> bool:
        return self._queue.unfinished_tasks > 0

    def _target_text(self) -> str:
        running = self._running
        return f"{running.config}/{running.mode}" if running else "another mode"

    def _enqueue(self, change: Change) -> Change:
        try:
            self._queue.put_nowait(change)
        except queue.Full:
            raise ChangeBusy(f"{QUEUE_LENGTH} changes wait already; try again when one has ended") from None
        return change

    def _work(self) -> None:
        while (change := self._queue.get()) is not None:
            if self._stopping.is_set():
                self._queue.task_done()
                change.finish(ErrorInfo("cancelled", "the configuration manager is stopping"), 0.0)
            else:
                self._run(change)
        self._queue.task_done()

    def _run(self, change: Change) -> None:
        started = self._env.clock.monotonic()
        config = self.configs[change.config]
        self._pending = self._begun(change)
        self._running, self._failed = change, False
        self.progress(Progress(change.number, change.config, change.mode, "validate"))
        error: ErrorInfo | None = None
        try:
            if change.cancelled:
                raise Cancelled("the change was cancelled before it began")
            self.leases.check(change.scopes, change.lease)  # one may have been given while this change waited
            goal = Goal(config, change.mode, change.force, static=self.configs.get(change.static or ""))
            self._runner.run(goal, change.number, lambda: change.cancelled)
        except CmError as problem:
            error = ErrorInfo(getattr(problem, "cause_code", problem.code), str(problem))
        except Exception as problem:  # noqa: BLE001 (a defect of ours must not end the worker)
            error = ErrorInfo("internal", f"{type(problem).__name__}: {problem}")
        self._end(change, error, self._env.clock.monotonic() - started)

    def _begun(self, change: Change) -> Pending:
        state = self.state
        whole = self.configs[change.config].type is ConfigType.FULL
        there = state.config == change.config and not change.force
        self._full = (whole and not there) or change.static is not None
        return Pending(
            change.number, change.config, change.mode, state.config, state.mode, from_static=state.static_config
        )

    def _end(self, change: Change, error: ErrorInfo | None, seconds: float) -> None:
        self._pending, self._progress, self._running = None, None, None
        self._last = (change.number, seconds)
        self._error, self._failed = error, error is not None and error.code != "cancelled"
        self.lock_regions(frozenset())
        self._try_record()
        self._queue.task_done()
        self._env.observer.status_changed()
        change.finish(error, seconds)
        if error is None and self._queue.empty():
            self._prefetch()

    def _try_record(self) -> None:
        try:
            self.record(None)
        except OSError as problem:
            if self._error is None:  # what went wrong with the change is of more use
                self._error = ErrorInfo("store", f"the state record could not be written: {problem}")

    def _prefetch(self) -> None:
        """Hold the loaded configuration's images ready. What is wrong with them shows when they are used."""
        config = self.loaded_config() if self._env.settings.prefetch_bytes else None
        jobs = []
        for module in config.modules.values() if config else ():
            if not self._queue.empty() or config is None:
                return
            with contextlib.suppress(CmError, OSError):
                image = self._env.files.image(config, module)
                jobs.append(Job(config, image, config.regions[module.region], module))
        with contextlib.suppress(CmError, OSError):
            self._loaders.prefetch(jobs, self._queue.empty)

    # ---- what a transaction needs (cm.manager.transaction.Board) ---------------------

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state in one piece; both threads do."""
        with self._access:
            self.state = change(self.state)

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """Keep a measurement for plans and time-outs."""
        self.throughput = self.throughput.observed(kind, length, seconds)

    def record(self, step: Step | None) -> None:
        """Write state and pending step to the store. Raises OSError."""
        with self._access:
            pending = self._pending
            if pending is not None and step is not None:
                overlay = _overlay_name(step)
                pending = replace(pending, step=step.kind, subject=step.subject, overlay=overlay)
            elif step is None:
                pending = None
            self._env.store.write(Record(self._boot_id, self.state, pending, self.throughput, self._number))
            self._dirty = False

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """Keep requests off these regions' registers, or off all; waits for an access under way."""
        self._desk.keep_off(Locked(regions, whole))

    def progress(self, progress: Progress) -> None:
        """Publish how far the running change is."""
        self._progress = progress
        self._env.observer.status_changed()

    # ---- registers -----------------------------------------------------------------

    def write_registers(self, writes: tuple[RegWrite, ...], lease: str = "") -> RegValues:
        """Check all, then write in order; returns and publishes what the registers then hold."""
        try:
            result = self._desk.write(writes, lease)
        finally:
            self._dirty = True
        self._env.observer.registers_changed(result)
        return result

    def flush(self) -> None:
        """Record register values that were written since the last record."""
        if self._dirty:
            self._try_record()

    # ---- status --------------------------------------------------------------------

    def status(self) -> Status:
        """The state as it is told; streams, sequence and version are the daemon's to add."""
        running, progress, state = self._running, self._progress, self.state
        return Status(
            config_name=state.config or "",
            mode=state.mode or "",
            fpga_busy=running is not None,
            pr_mode=self._pr_mode(running),
            progress=progress,
            last_error=self._error,
            regions=region_states(self.loaded_config(), state),
            configs=tuple(sorted(self.configs)),
            last_change=self._last[0],
            last_change_seconds=self._last[1],
        )

    def _pr_mode(self, running: Change | None) -> PrMode:
        if running is not None:
            return PrMode.FULL if self._full else PrMode.PARTIAL
        return PrMode.ERROR if self._failed else PrMode.IDLE

    def note_error(self, error: ErrorInfo) -> None:
        """Tell an error of a request that has no reply."""
        self._error = error
        self._env.observer.status_changed()

    def board_lost(self, error: Exception) -> None:
        """The board does not answer any more: nothing is known of it."""
        with self._access:
            self._loaders.forget()
            self.registers.forget(lost=True)
            self._failed = True
            self._error = ErrorInfo("device_gone", f"the board does not answer: {error}")
        self._env.observer.status_changed()


def _overlay_name(step: Step) -> str | None:
    if isinstance(step, ApplyOverlay):
        return step.overlay.name
    return step.name if isinstance(step, RemoveOverlay) else None

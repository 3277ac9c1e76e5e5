# SPDX-License-Identifier: Apache-2.0
"""The manager: configurations, the state of the board, changes one after the other, registers by name.

Threads: requests come from one thread (the daemon's loop); one worker thread runs changes. All that is known are
immutable values that are swapped (`cm.manager.state.journal`).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from time import monotonic_ns
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cm.frozen import dataclass, replace
from cm.manager import planner
from cm.manager.access.leases import Leases, leases_concerned
from cm.manager.access.memory_service import MemoryService
from cm.manager.access.register_bus import RegisterBus
from cm.manager.access.register_service import RegisterService
from cm.manager.errors import ChangeBusy, NothingLoaded, RecordFailed, listed
from cm.manager.execution.region_readback import Checked, Pace, Scan, checked_region, loaded_map
from cm.manager.execution.transaction import Tools, plan_to
from cm.manager.execution.worker import Change, Look, Worker
from cm.manager.loaders import Loaders
from cm.manager.planner import Goal
from cm.manager.recovery import (
    destination,
    held_images,
    is_whole,
    port_error,
    repair,
    take_stock,
    under_schema,
    undo,
    way_back,
)
from cm.manager.state.board_state import BoardState, all_lost, slept, taken, without_overlays
from cm.manager.state.journal import Journal, ManagerState
from cm.manager.state.steps import ApplyOverlay
from cm.manager.status_reports import Moment, StatusReporter, config_info
from cm.manager.touched import emptied
from cm.schema.model import Config
from cm.wire.messages.requests import ChangeMode, CheckRegion, RegWrite
from cm.wire.messages.status import (
    ConfigInfo,
    ErrorInfo,
    PlanInfo,
    RegionCheck,
    RegionMap,
    RegValues,
    Status,
    WindowStatus,
    place,
)

if TYPE_CHECKING:
    from cm.manager.access.register_windows import Windows
    from cm.manager.interfaces import DataPlane, Devices, Files, Observer, RegisterTable, TimeSource


@dataclass(frozen=True, slots=True)
class Settings:
    """What an operator may set."""

    prefetch_bytes: int = 64 << 20  # DMA memory that images of the loaded configuration may take
    new_board: bool = False  # each start of it makes another board, as of a simulated one: no news


@dataclass(frozen=True, slots=True)
class Environment:
    """Everything the manager is given."""

    devices: Devices
    files: Files
    journal: Journal
    data_plane: DataPlane
    time: TimeSource
    observer: Observer
    settings: Settings = Settings()


class Manager:
    """One per board. `start()` reconciles and starts the worker; `stop()` ends it between two changes."""

    def __init__(self, configs: Mapping[str, Config], env: Environment, leases: Leases | None = None) -> None:
        """`leases` are shared with the data plane."""
        self._env = env
        self._state = state = ManagerState(configs, env.journal)
        self._bus = RegisterBus(env.devices)
        self.leases = leases or Leases(env.time)
        self._loaders = Loaders(env.devices, env.files, env.time, env.settings.prefetch_bytes)
        self.registers = RegisterService(state, self._bus, self.leases)
        self.memories = MemoryService(state, self.registers, self._bus, self.leases)
        self.reporter = StatusReporter(state, env.observer)
        self.leases.on_change = self._leases_changed
        self._windows: Windows | None = None
        self._tools = Tools(
            state,
            self.reporter,
            env.devices,
            self._bus,
            self._loaders,
            env.files,
            env.data_plane,
            env.time,
            self._take_back,
        )
        self._worker = Worker(self._tools, self.leases)

    @property
    def state(self) -> BoardState:
        """What the board holds, as far as is known."""
        return self._state.board

    @property
    def windows(self) -> Windows:
        """Registers that clients have mapped. Nothing of it is there before somebody asks."""
        if self._windows is None:
            from cm.manager.access.register_windows import Windows

            self._windows = Windows(self._state, self.registers, self._bus, self.leases, self._env.time)
            self._windows.changed = self.reporter.changed
        return self._windows

    @property
    def mapped(self) -> tuple[WindowStatus, ...]:
        """Who has which registers mapped."""
        return self._windows.statuses() if self._windows is not None else ()

    def publish_to(self, table: RegisterTable) -> None:
        """From now on withdraw what `registers.offer` puts there, wherever a name may lead elsewhere."""
        self._state.moved = self._bus.closing = table.withdraw

    def _take_back(self, config: str, mode: str) -> None:
        if self._windows is not None:
            self._windows.revoke(self._state.locked, config, mode)

    def _leases_changed(self) -> None:
        if self._windows is not None:
            self._windows.look_at_leases()
        self.reporter.changed()

    def _forget_windows(self) -> None:
        if self._windows is not None:
            self._windows.forget()

    @property
    def configs(self) -> Mapping[str, Config]:
        """All configurations that can be loaded."""
        return self._state.configs

    # ---- life -------------------------------------------------------------------

    def start(self) -> tuple[str, ...]:
        """Find out what the board holds; returns what was noticed, in sentences. Raises DeviceError.

        A change that was cut short is undone: the board goes back to the mode before it, as a change
        of its own that the worker runs first.
        """
        notes = self.reconcile(self._env.settings.new_board)
        self._worker.start()
        return notes

    def reconcile(self, new_board: bool = False) -> tuple[str, ...]:
        """Compare record and board (again). Called before the worker starts, or when it is idle."""
        finding = take_stock(self._state, self._env.devices, self._bus, self._env.files, new_board)
        if finding.notes:
            self.reporter.set_notice(ErrorInfo("reconciled", "; ".join(finding.notes)))
        there = destination(self.state, finding.interrupted, self.configs)
        if there is None:
            self._state.update(self._in_no_mode)
        elif finding.interrupted is None and is_whole(self.state, there):
            there = None
        self._env.data_plane.resume(self.loaded_config(), self.state.mode, self.state.modules)
        cut = finding.interrupted if there is not None else None  # if killed before its end, this is begun anew
        self.reporter.note(self._state.try_record(cut))  # a full disk is no reason not to serve
        if there is not None:  # the board is in no whole mode
            change = repair(self._state.next_number(), there, cut, self.state)
            change.why = "to undo a change that was cut short" if cut else "to bring the board back, which held less"
            self.reporter.begun(change.number, change.config, change.mode, full=change.static is not None)
            self._worker.add(change)  # busy from now on, as no client may take what is there for what will be
        self.reporter.changed()
        return finding.notes

    def _in_no_mode(self, state: BoardState) -> BoardState:
        """Where regions were unloaded, the static part of their configuration is there still."""
        kept = state.config in self.configs and any(region.empty for region in state.regions.values())
        return replace(state, config=state.config if kept else None, mode=None)

    def board_restarted(self) -> None:
        """The board was started anew: nothing that is recorded is true any more.

        Raises DeviceError, and ChangeBusy until the change that runs has ended.
        """
        if self._worker.busy:
            raise ChangeBusy("the board was restarted while a change runs; its end is awaited")
        self._loaders.forget()
        self._forget_windows()
        self._bus.forget(lost=True)
        self.reconcile()

    def board_slept(self) -> None:
        """The machine slept, and the PL may have lost its power: nothing is claimed of its content any more.

        Where this manager loaded the image of the whole device, that is loaded again; else what was there at boot is
        taken to be there still. The mode is brought back by a change. Raises ChangeBusy until a running one has ended.
        """
        if self._worker.busy:
            raise ChangeBusy("the machine slept while a change ran; its end is awaited")
        before = self.state
        self._forget_windows()
        there = destination(before, None, self.configs)
        self._bus.forget()
        self._state.update(slept)
        self.reporter.set_notice(ErrorInfo("slept", "the machine slept: what the PL held is loaded again"))
        self.reporter.note(self._state.try_record())
        if there is not None:
            static = before.static_config if before.static_config in self.configs else None
            goal = self._state.next_number(), there.config.name, there.mode
            self._worker.add(
                Change(*goal, static=static, why="as the machine slept, and the PL may have lost its power")
            )
        self.reporter.changed()

    def board_taken(self, loads: Sequence[str], removed: Collection[str], who: str = "") -> None:
        """Others have loaded the PL (in sentences), or removed overlays of ours: what was known is not served any more.

        Nothing is loaded in its place: that would be a fight. Raises ChangeBusy while a change runs.
        """
        if self._worker.busy:
            raise ChangeBusy("another program loaded the PL while a change ran; its end is awaited")
        self._forget_windows()
        self._bus.forget()
        if loads:
            self._state.update(self._after_other_loads)
        if removed:
            self._state.update(lambda state: without_overlays(state, removed))
        told = [*loads, *(f"overlay {name} was removed" for name in removed)]
        left = "nothing is known of what the PL holds" if loads else "the board is in no mode"
        text = f"by another program: {'; '.join(told)}; {left}: cm load brings a mode back{who and f'; {who}'}"
        self.reporter.set_notice(ErrorInfo("other_loader", text))
        self._state.taken = text
        self._env.data_plane.resume(self.loaded_config(), self.state.mode, self.state.modules)
        self.reporter.note(self._state.try_record())
        self.reporter.changed()

    def _after_other_loads(self, state: BoardState) -> BoardState:
        """A load that the kernel says went wrong has left an empty device, which must not be accessed."""
        return all_lost(state) if port_error(self._env.devices, None) else taken(state)

    def board_lost(self, error: Exception) -> None:
        """The board does not answer any more: nothing is known of it."""
        with self._state.lock:
            self._loaders.forget()
            self._forget_windows()
            self._bus.forget(lost=True)
            self.reporter.set_error(ErrorInfo("device_gone", f"the board does not answer: {error}"), failed=True)
        self.reporter.changed()

    def stop(self) -> None:
        """End after the running change; queued ones are refused as cancelled."""
        self._worker.stop()
        self._loaders.forget()
        self._forget_windows()
        self.flush()

    # ---- configurations -----------------------------------------------------------

    def images_of(self, config: Config) -> Mapping[str, str]:
        """What `add_config` has to know of a new schema of the loaded configuration; reads its files. Any thread."""
        replaces = self.state.config == config.name and self.state.schema != config.sha256_source
        return held_images(config, self.state, self._env.files) if replaces else {}

    def add_config(self, config: Config, images: Mapping[str, str] = MappingProxyType({})) -> None:
        """Make a configuration known (again). Raises ChangeBusy while it is being changed to.

        `images`: those that a new schema of the loaded one has of what the board holds (`images_of`); what it holds
        beside that is not offered under this schema.
        """
        self.check_replaceable(config.name)
        self._state.add_config(config)
        if self.state.config == config.name:
            self._under_schema(config, images)
            if not self._worker.busy:
                self._env.data_plane.resume(self.loaded_config(), self.state.mode, self.state.modules)
        self.reporter.changed()

    def _under_schema(self, config: Config, images: Mapping[str, str]) -> None:
        notes: list[str] = []
        if self.state.mode not in config.modes:
            self._state.update(lambda state: replace(state, mode=None))  # it is in none of the present modes
        if self.state.schema != config.sha256_source:
            self._state.update(lambda state: under_schema(state, config, images, notes))
        if notes:
            self._forget_windows()
            self.reporter.set_notice(ErrorInfo("reconciled", "; ".join(notes)))

    def forget_config(self, name: str) -> None:
        """Make a configuration unknown. Raises ChangeBusy while it is in use."""
        if self.in_use(name):
            raise ChangeBusy(f"configuration {name!r} is in use")
        self._state.forget_config(name)
        self.reporter.changed()

    def in_use(self, name: str) -> bool:
        """Whether a configuration is loaded, or a change runs or waits that may need it."""
        return name == self.state.config or self._worker.busy

    def check_replaceable(self, name: str) -> None:
        """Raise ChangeBusy while a configuration is being changed to: its files are in use."""
        running = self._worker.running
        if running is not None and running.config == name:
            raise ChangeBusy(f"configuration {name!r} is being loaded; provision it when the change has ended")

    def loaded_config(self) -> Config | None:
        """The configuration that is loaded."""
        return self._state.loaded_config()

    def status(self, moment: Moment | None = None, **beside: Any) -> Status:
        """The state as it is told, of a moment or of now, with what is the daemon's: streams, sequence, version."""
        return self.reporter.status(moment, **beside)

    def describe(self, name: str, counts: Mapping[str, int]) -> ConfigInfo:
        """A configuration, with its schema's text; the loaded one if `name` is empty."""
        loaded = self.state
        if not name and loaded.config is None:
            raise NothingLoaded("nothing is loaded: name a configuration")
        config = planner.config_named(name or loaded.config or "", self.configs)
        mode = loaded.mode if loaded.config == config.name else ""
        text = config.source.read_text(encoding="utf-8") if config.source and config.source.exists() else ""
        return config_info(config, mode or "", counts, text, loaded.modules)

    # ---- changes --------------------------------------------------------------------

    def submit(
        self, request: ChangeMode, on_done: Callable[[Change], None] | None = None, by: str = "", why: str = ""
    ) -> Change:
        """Accept a change; it runs when those before it have ended. Nothing is touched if this raises.

        Where nothing is loaded yet, one without a configuration is for that of the change before it.
        `on_done` is called at its end, from the worker's thread. `by` asked for it, or it is made for a reason (`why`).
        """
        coming = self._worker.coming  # before the state, which names it from its end on
        config, mode = planner.target(request, self.configs, self.state.config or coming)
        regions = emptied(config, request.unload) if request.unload else ()
        scopes = leases_concerned(config, mode, self.state.config, regions)
        self.leases.check(scopes, request.lease)
        if request.no_queue and self._worker.busy:
            running = self._worker.running
            to = place(running.config, running.mode) if running else "a mode"
            raise ChangeBusy(f"a change to {to} is running")
        number = self._state.next_number()
        change = Change(number, config.name, mode, request.force, scopes=scopes, lease=request.lease, on_done=on_done)
        change.asked, change.undoable, change.by, change.why = True, request.undoable, by, why
        if request.unload:
            change.unload, change.why = request.unload, f"to unload {', '.join(regions) or config.name}"
        if request.undo:
            if self._worker.busy:
                raise ChangeBusy("a change runs: only the last one that has ended can be undone")
            undo(change, way_back(request.undo, config.name, mode, self._state), self._state)
            change.why = f"to undo the change {request.undo!r}"
        return self._worker.add(change)

    def prepared_check(self, name: str) -> Checked:
        """A region, ready to be compared with what was loaded into it; reads its bitstream. Any thread.

        Raises NotFound, RegionBusy, NoReadback, and what is wrong with the file.
        """
        return checked_region(name, self._state, self._env.devices, self._env.files)

    def region_map(self, name: str) -> RegionMap:
        """What was loaded into a region, counted, and what the last check has found; reads its bitstream. Any thread.

        Raises NotFound, RegionBusy where nothing is known of what it holds, and what is wrong with the file.
        """
        return self.reporter.health.on(loaded_map(name, self._state, self._env.files))

    def check(
        self, what: Checked, on_done: Callable[[RegionCheck | Exception], None], pace: Pace | None = None
    ) -> None:
        """Compare a region; `on_done` is called at the end, from the worker's thread. Raises ChangeBusy.

        `pace`: pauses between slices, as of a `Look`.
        """
        started, scan = self._env.time.monotonic(), Scan(what, self._state, self._env.devices)

        def done(error: Exception | None) -> None:
            if error is None:
                self._worker.note(scan)
                if scan.wrong or pace is None:  # passes in the background that find nothing are counted, not told
                    self.reporter.changed()
            on_done(error or scan.result(self._env.time.monotonic() - started))

        self._worker.look(Look(scan, done, pace))

    def repair(
        self, request: CheckRegion, on_done: Callable[[Change], None] | None = None, by: str = "", why: str = ""
    ) -> Change:
        """Accept a change that compares a region and repairs it; `on_done` as for `submit`."""
        config, mode = self.loaded_config(), self.state.mode
        if config is None or mode is None:
            taken = self._state.taken and f"; {self._state.taken}"
            raise NothingLoaded(f"nothing is loaded: there is no region to compare{taken}")
        planner.check_region(config, request.name)
        scopes = (f"region:{request.name}",)
        self.leases.check(scopes, request.lease)
        number = self._state.next_number()
        change = Change(number, config.name, mode, scopes=scopes, lease=request.lease, on_done=on_done)
        change.repairs, change.reloads, change.by = request.name, request.reload, by
        change.why = why or f"to compare region {request.name} with what was loaded, and repair it"
        return self._worker.add(change)

    @property
    def changing(self) -> bool:
        """Whether a change runs or waits."""
        return self._worker.busy

    def wait_idle(self) -> None:
        """Wait until no change runs or waits."""
        self._worker.wait_idle()

    @property
    def running(self) -> Change | None:
        """The change that runs."""
        return self._worker.running

    @property
    def coming(self) -> Config | None:
        """The configuration to which the change goes that was asked for last, until that has ended."""
        return self.configs.get(self._worker.coming or "")

    def cancel(self, number: int | None = None) -> bool:
        """Cancel the running change, if there is one, and it has this number where one is given."""
        running = self._worker.running
        if running is None or number not in (None, running.number):
            return False
        running.cancel()
        return True

    def plan(self, request: ChangeMode) -> PlanInfo:
        """What a change would do; touches nothing, but reads and validates all files."""
        config, mode = planner.target(request, self.configs, self.state.config)
        unload = request.unload
        mode = planner.mode_left(config, self.state.mode, unload) if unload else mode
        plan = plan_to(Goal(config, mode, request.force, unload=unload), self._tools)
        applied = {o.overlay.name: o.data for o in (*plan.steps, *plan.then) if isinstance(o, ApplyOverlay)}
        clashes = self._tools.files.clashes(applied, [o.name for o in self.state.overlays]) if applied else {}
        info = plan.info(self._state.throughput)
        rows = tuple(
            replace(row, text=f"{row.text}; its devices get no driver: {clashes[row.subject]}")
            if row.kind == ApplyOverlay.kind and row.subject in clashes
            else row
            for row in info.steps
        )
        return replace(info, steps=rows)

    # ---- registers and errors of requests -------------------------------------------

    def write_registers(self, writes: tuple[RegWrite, ...], lease: str = "", by: str = "") -> RegValues:
        """Check all, then write in order; returns and publishes what the registers then hold. `by`: as of `submit`."""
        return self.tell_registers(self.registers.write(writes, lease), by)

    def tell_registers(self, result: RegValues, by: str = "") -> RegValues:
        """Publish what was written; what cannot be read back is recorded first. Raises RecordFailed for that."""
        written, now = self.reporter.history.written, monotonic_ns()
        for value in result.values:
            written[value.name] = value.value, now, by
        unkept = self._state.flush() if self._state.urgent else None
        self._env.data_plane.wrote(result.generation)  # before any client knows its number
        self._env.observer.registers_changed(result)
        if unkept is not None:
            self.reporter.note(unkept)
            if names := self.registers.unread(value.name for value in result.values):
                raise RecordFailed(
                    f"{listed(names)} was written, but is not known after a restart, as it cannot be read back: "
                    f"{unkept.message}"
                )
        return result

    def flush(self) -> None:
        """Record what was noted since the last record: values of registers, and how long steps took."""
        self.reporter.note(self._state.flush())

    def note_error(self, error: ErrorInfo) -> None:
        """Publish an error of a request that has no reply."""
        self.reporter.set_error(error)
        self.reporter.changed()

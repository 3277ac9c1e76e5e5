# SPDX-License-Identifier: Apache-2.0
"""The status that is told: the change that runs, how far it is, how the last one ended."""

from __future__ import annotations

from collections.abc import Mapping

from cm.manager.ports import Observer
from cm.manager.state.board_state import ManagerState
from cm.manager.state.choice import Choice
from cm.manager.state.table import BoardState
from cm.messages.status import ClockStatus, ErrorInfo, PrMode, Progress, RegionStatus, Status, StreamStatus
from cm.schema.model import Config, Stream


class StatusReporter:
    """Puts the status together, and tells the observer when it differs."""

    def __init__(self, state: ManagerState, observer: Observer) -> None:
        self._state = state
        self._observer = observer
        self._running = False
        self._full = False  # the running change loads a whole image
        self._progress: Progress | None = None
        self._error: ErrorInfo | None = None
        self._notice: ErrorInfo | None = None  # what was found out beside changes; told until a client has read it
        self._notice_read = False
        self._failed = False
        self._last: tuple[int, float] = (0, 0.0)  # number and seconds of the last change

    def begun(self, number: int, config: str, mode: str, full: bool) -> None:
        """A change runs from now on; `full` if it loads a whole image."""
        self._running, self._full, self._failed = True, full, False
        self.progress(Progress(number, config, mode, "validate"))

    def progress(self, progress: Progress) -> None:
        """How far the running change is."""
        self._progress = progress
        self._observer.status_changed()

    def ended(self, number: int, error: ErrorInfo | None, seconds: float) -> None:
        """No change runs any more; `changed` tells it."""
        self._progress, self._running = None, False
        self._state.totals.ended(error.code if error else None, seconds)
        self._last = (number, seconds)
        self._error, self._failed = error, error is not None and error.code != "cancelled"
        if self._notice_read:
            self._notice = None

    def note(self, error: ErrorInfo | None) -> None:
        """An error beside changes; one that is already told is of more use."""
        if self._error is None:
            self._error = error

    def set_notice(self, notice: ErrorInfo) -> None:
        """What is to be told until a client has read it and a change has ended since; errors go before it."""
        self._error, self._notice, self._notice_read = None, notice, False

    def was_read(self) -> None:
        """A client has been told the status."""
        self._notice_read = self._error is None

    def set_error(self, error: ErrorInfo, failed: bool = False) -> None:
        """An error to be told from now on; `failed` where the board is in no good state for it."""
        self._error, self._failed = error, failed or self._failed

    def changed(self) -> None:
        """The status differs from before."""
        self._observer.status_changed()

    def status(self) -> Status:
        """The state as it is told; streams, sequence and version are the daemon's to add."""
        running, progress, board = self._running, self._progress, self._state.board
        return Status(
            config_name=board.config or "",
            mode=board.mode or "",
            fpga_busy=running,
            pr_mode=self._pr_mode(running),
            progress=progress,
            last_error=self._error or self._notice,
            regions=region_states(self._state.loaded_config(), board, self._state.choices),
            configs=tuple(sorted(self._state.configs)),
            last_change=self._last[0],
            last_change_seconds=self._last[1],
            clocks=clock_states(self._state.loaded_config(), board),
            generation=self._state.generation,
        )

    def _pr_mode(self, running: bool) -> PrMode:
        if running:
            return PrMode.FULL if self._full else PrMode.PARTIAL
        return PrMode.ERROR if self._failed else PrMode.IDLE


def stream_status(stream: Stream) -> StreamStatus:
    """A stream as the schema has it, not open."""
    return StreamStatus(
        stream.name,
        stream.channel,
        stream.direction.value,
        stream.shape or (),
        stream.dtype,
        stream.slots,
        cyclic=stream.cyclic,
        backpressure=stream.backpressure,
        stride=stream.stride or 0,
        limit=stream.limit or 0.0,
    )


def region_states(
    config: Config | None, state: BoardState, choices: Mapping[tuple[str, str], Choice]
) -> tuple[RegionStatus, ...]:
    """All regions that are known, those of the loaded configuration first."""
    names = dict.fromkeys([*(config.regions if config else ()), *state.regions])
    chosen = {n: choices.get((config.name, n)) for n in names} if config else {}
    return tuple(
        RegionStatus(n, state.region(n).module, state.region(n).phase.value, _loader(chosen.get(n))) for n in names
    )


def _loader(choice: Choice | None) -> str:
    if choice is None:
        return ""
    return f"{choice.kind.value} ({choice.why})" if choice.why else choice.kind.value


def clock_states(config: Config | None, state: BoardState) -> tuple[ClockStatus, ...]:
    """The clocks of the loaded configuration, with the rates that were read back."""
    clocks = config.clocks.values() if config else ()
    return tuple(ClockStatus(clock.name, clock.rate, state.clocks.get(clock.name, 0)) for clock in clocks)

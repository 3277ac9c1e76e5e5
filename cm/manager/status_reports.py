# SPDX-License-Identifier: Apache-2.0
"""What clients are told: the board's status, its configurations, modes and registers, and the sums of its changes."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from cm.frozen import replace
from cm.manager.history import History
from cm.manager.state.board_state import BoardState, RegionState
from cm.manager.state.journal import Kept, ManagerState
from cm.manager.state.steps import Choice
from cm.schema.model import Config, Memory, Register, Stream
from cm.wire.messages.status import (
    BlockInfo,
    ClockStatus,
    ConfigEntry,
    ConfigInfo,
    ErrorInfo,
    FieldInfo,
    FrameError,
    InterruptInfo,
    MemoryInfo,
    ModeInfo,
    PrMode,
    Progress,
    RegionCheck,
    RegionHealth,
    RegionMap,
    RegionStatus,
    RegisterInfo,
    Status,
    StreamStatus,
)

if TYPE_CHECKING:
    from cm.manager.interfaces import Observer

_T = TypeVar("_T")
_UNKNOWN = RegionState()  # of which nothing is known


class Moment(NamedTuple):
    """What a status is made of: as all of it stays as it is, the status can be made later, in another thread."""

    running: bool
    pr_mode: PrMode
    progress: Progress | None
    error: ErrorInfo | None
    last: tuple[int, float, int]  # number and seconds of the last change, and CLOCK_MONOTONIC at its end, ns
    generation: int
    board: BoardState
    config: Config | None  # that is loaded
    configs: Mapping[str, Config]
    choices: Mapping[tuple[str, str], Choice]
    health: Mapping[str, RegionHealth]


class StatusReporter:
    """Puts the status together, and tells the observer when it differs."""

    def __init__(self, state: ManagerState, observer: Observer) -> None:
        self._state = state
        self._observer = observer
        self.health = Health()  # since this manager's start
        self.history = History()  # likewise
        self._running = False
        self._full = False  # the running change loads a whole image
        self._progress: Progress | None = None
        self._error: ErrorInfo | None = None
        self._notice: ErrorInfo | None = None  # what was found out beside changes; told until a client has read it
        self._notice_read = False
        self._failed = False
        self._last: tuple[int, float, int] = (0, 0.0, 0)
        self._regions, self._clocks = Kept(region_states), Kept(clock_states)
        self._configs = Kept(lambda configs: tuple(sorted(configs)))

    def begun(self, number: int, config: str, mode: str, full: bool) -> None:
        """A change runs from now on; `full` if it loads a whole image."""
        self._running, self._full, self._failed = True, full, False
        self.progress(Progress(number, config, mode, "validate"))

    def progress(self, progress: Progress) -> None:
        """How far the running change is."""
        self._progress = progress
        self._observer.progressed()

    def ended(self, number: int, error: ErrorInfo | None, seconds: float, touched: bool = True) -> None:
        """No change runs any more; `changed` tells it. `touched`: whether it has done anything to the board."""
        self._progress, self._running = None, False
        self._last = (number, seconds, time.monotonic_ns())
        code = error.code if error else "cancelled"
        self._error, self._failed = error, code == "device_gone" or (touched and code != "cancelled")
        if self._notice_read:
            self._notice = None

    def note(self, error: ErrorInfo | None) -> None:
        """Report an error beside changes, unless there is one already, which is of more use."""
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

    def moment(self) -> Moment:
        """What a status of now is made of. Any thread."""
        running, state, error = self._running, self._state, self._error or self._notice
        board, generation = state.board, state.generation
        if running:
            pr_mode = PrMode.FULL if self._full else PrMode.PARTIAL
        else:
            pr_mode = PrMode.ERROR if self._failed else PrMode.IDLE
        what = running, pr_mode, self._progress, error, self._last, generation, board
        return Moment(*what, state.loaded_config(), state.configs, state.choices, self.health.told)

    def status(self, moment: Moment | None = None, **beside: Any) -> Status:
        """The state of a moment as it is told, or of now; `beside`: streams, sequence and the like, the daemon's."""
        m = moment or self.moment()
        return Status(
            config_name=m.board.config or "",
            mode=m.board.mode or "",
            fpga_busy=m.running,
            pr_mode=m.pr_mode,
            progress=m.progress,
            last_error=m.error,
            regions=self._regions.of(m.config, m.board.regions, m.choices, m.health),
            configs=self._configs.of(m.configs),
            last_change=m.last[0],
            last_change_seconds=m.last[1],
            last_change_ns=m.last[2],
            clocks=self._clocks.of(m.config, m.board.clocks),
            generation=m.generation,
            **beside,
        )


class Health:
    """What checks of regions have found, by region. The worker's thread; `told` and `of` are for any."""

    def __init__(self) -> None:
        self.told: Mapping[str, RegionHealth] = MappingProxyType({})
        self._wrong: Mapping[str, tuple[FrameError, ...]] = MappingProxyType({})  # by the last check of what is there
        self._known: dict[str, frozenset[tuple[int, int]]] = {}  # bits that are counted already

    def checked(self, found: RegionCheck, wrong: frozenset[tuple[int, int]]) -> None:
        """A check went over all of a region, and found these bits wrong (frame address, bit)."""
        region, before = found.region, self.of(found.region)
        new = len(wrong - self._known.get(region, frozenset()))
        self._known[region] = wrong
        self._wrong = MappingProxyType({**self._wrong, region: found.wrong})
        counted = before.checks + 1, before.upsets + new, before.repairs, len(wrong), found.frames, found.unjudged
        self._tell(region, RegionHealth(*counted, time.monotonic_ns()))

    def repaired(self, region: str) -> None:
        """What was wrong is right again."""
        self._tell(region, replace(self.of(region), repairs=self.of(region).repairs + 1))

    def mended(self, region: str) -> None:
        """It was loaded: what was found wrong is gone, and what is there was not checked yet."""
        self._known.pop(region, None)
        self._wrong = MappingProxyType({name: wrong for name, wrong in self._wrong.items() if name != region})
        if region in self.told:
            self._tell(region, replace(self.told[region], wrong_bits=0, checked_ns=0))

    def of(self, region: str) -> RegionHealth:
        """A region's."""
        return self.told.get(region, RegionHealth())

    def on(self, found: RegionMap) -> RegionMap:
        """A map with what the last check has found, where there was one since the region was loaded."""
        wrong = self._wrong.get(found.region)
        if wrong is None:
            return found
        return replace(found, wrong=wrong, checked=(time.monotonic_ns() - self.of(found.region).checked_ns) / 1e9)

    def _tell(self, region: str, health: RegionHealth) -> None:
        self.told = MappingProxyType({**self.told, region: health})


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
        format=stream.format or "",
        slot_bytes=stream.slot_bytes or 0,
    )


def region_states(
    config: Config | None,
    regions: Mapping[str, RegionState],
    choices: Mapping[tuple[str, str], Choice],
    health: Mapping[str, RegionHealth],
) -> tuple[RegionStatus, ...]:
    """All regions that are known, those of the loaded configuration first."""
    names = dict.fromkeys([*(config.regions if config else ()), *regions])
    chosen = {n: choices.get((config.name, n)) for n in names} if config else {}
    states = ((n, regions.get(n, _UNKNOWN)) for n in names)
    return tuple(RegionStatus(n, x.module, x.phase.value, _loader(chosen.get(n)), health.get(n)) for n, x in states)


def _loader(choice: Choice | None) -> str:
    if choice is None:
        return ""
    return f"{choice.kind.value} ({choice.why})" if choice.why else choice.kind.value


def clock_states(config: Config | None, rates: Mapping[str, int]) -> tuple[ClockStatus, ...]:
    """The clocks of the loaded configuration, with the rates that were read back."""
    clocks = config.clocks.values() if config else ()
    return tuple(ClockStatus(clock.name, clock.rate, rates.get(clock.name, 0)) for clock in clocks)


_LONG = 200  # registers


def config_info(
    config: Config, mode: str, counts: Mapping[str, int], schema: str, held: Mapping[str, str | None]
) -> ConfigInfo:
    """A configuration; `mode` is empty while it is not loaded, `counts` are its interrupts', `held` the modules."""
    streams = config.streams_in(mode, held) if mode in config.modes else config.streams
    return ConfigInfo(
        name=config.name,
        type=config.type.value,
        mode=mode,
        modes=tuple(_mode(config, name) for name in config.modes),
        registers=_registers(config),
        interrupts=tuple(InterruptInfo(i.name, i.doc, counts.get(i.name, 0)) for i in config.interrupts.values()),
        streams=tuple(stream_status(x) for x in streams.values()),
        schema=schema,
        memories=_memories(config),
        blocks=tuple(
            BlockInfo(b.name, b.base_address, b.size, b.vlnv, b.prefix, b.interrupts, b.streams, b.doc)
            for b in config.blocks.values()
        ),
    )


def is_long(config: Config | None) -> bool:
    """Whether describing a configuration takes longer than a request may; False where there is none."""
    if config is None:
        return False
    parts = [config.registers, *[m.registers for m in config.modules.values()]]
    return sum(map(len, [*parts, *[m.registers for m in config.modes.values()]])) > _LONG


def config_list(configs: Mapping[str, Config]) -> ConfigInfo:
    """All configurations by name, with their modes."""
    entries = tuple(
        ConfigEntry(name, c.type.value, tuple(c.modes), c.first_mode()) for name, c in sorted(configs.items())
    )
    return ConfigInfo(names=tuple(e.name for e in entries), entries=entries)


def _mode(config: Config, name: str) -> ModeInfo:
    mode = config.modes[name]
    overlays = tuple(o.name for o in (*config.overlays, *mode.overlays))
    return ModeInfo(name, mode.modules, tuple(config.visible_registers(name)), overlays)


def _registers(config: Config) -> tuple[RegisterInfo, ...]:
    return tuple(register_info(r, modes) for r, modes in _with_modes(config, config.visible_registers))


def _with_modes(config: Config, visible: Callable[[str], Mapping[str, _T]]) -> Iterator[tuple[_T, tuple[str, ...]]]:
    """What is visible, with its modes, none where all have it; modules may have different things of the same name."""
    found: dict[str, list[tuple[_T, list[str]]]] = {}
    for mode in config.modes:
        for name, thing in visible(mode).items():
            known = found.setdefault(name, [])
            modes = next((modes for told, modes in known if told is thing or _plain(told) == _plain(thing)), None)
            if modes is None:
                known.append((thing, modes := []))
            modes.append(mode)
    for thing, modes in itertools.chain.from_iterable(found.values()):
        yield thing, () if len(modes) == len(config.modes) else tuple(modes)


def _plain(thing: object) -> object:
    """A register whatever a mode's default for it."""
    return replace(thing, default=None) if isinstance(thing, Register) else thing


def register_info(r: Register, modes: tuple[str, ...] = ()) -> RegisterInfo:
    """A register; `modes` is empty where all have it."""
    return RegisterInfo(
        name=r.name,
        address=r.address,
        width=r.width,
        access=r.access.value,
        default=r.default,
        minimum=r.minimum,
        maximum=r.maximum,
        doc=r.doc,
        fields=tuple(
            FieldInfo(f.name, f.lsb, f.width, f.doc, tuple(f.values.items()), f.access.value if f.access else "")
            for f in r.fields.values()
        ),
        modes=modes,
        region=r.region or "",
        type="" if r.type == "uint" else r.type,
        fraction=r.fraction,
    )


def _memories(config: Config) -> tuple[MemoryInfo, ...]:
    return tuple(memory_info(m, modes) for m, modes in _with_modes(config, config.visible_memories))


def memory_info(m: Memory, modes: tuple[str, ...] = (), defined: bool = False) -> MemoryInfo:
    """A memory; `modes` is empty where all have it."""
    region, shape = m.region or "", m.shape or ()
    return MemoryInfo(m.name, m.address, m.size, m.access.value, m.dtype, shape, region, m.doc, modes, defined)

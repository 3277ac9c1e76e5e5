# SPDX-License-Identifier: Apache-2.0
"""What the manager knows, in memory and in its record on disk: what the hardware holds, and how long steps took.

All values are immutable, and are swapped. `ManagerState.lock` keeps register accesses of requests and the moments at
which a change takes regions away from overlapping; both threads take it.

The record is a journal of one line per record, JSON with a CRC, of which the last whole one counts. A line is a single
pwrite(2), so a killed manager leaves whole lines and at most one torn end. The file has its full length from the
beginning, and so has the one that will replace it (by a rename) when it is full: a disk that others have filled does
not prevent a change of mode. There is no fsync: after a loss of power the device is empty too, and the boot id shows
that.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import threading
import zlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from operator import is_
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from cm.errors import sentence
from cm.frozen import dataclass, field, replace
from cm.manager.errors import RecordFailed, StateInUse, StoreCorrupt
from cm.manager.state.board_state import BoardState, OverlayState, RegionPhase, RegionState
from cm.manager.state.steps import ApplyOverlay, CheckStatic, Choice, Place, RemoveOverlay, SetClock, Step, Validate
from cm.schema.model import Config, LoaderKind, Memory, Region
from cm.wire.messages.status import ErrorInfo

# Before anything was measured: facts of the ports (UG470 32 bit × 100 MHz; zynq-fpga over PCAP).
_NOMINAL = {LoaderKind.ICAP: 400e6, LoaderKind.FPGA_MANAGER: 145e6, LoaderKind.OVERLAY: 145e6}
_MARGIN = 20.0  # a load may take this many times what is expected before it counts as hung
_GRACE = 2.0  # seconds that any load may take
_RECENT = 5  # measurements of a kind that count

_VERSION = 3
_T = TypeVar("_T")
_json = json.JSONEncoder(separators=(",", ":")).encode


@dataclass(frozen=True, slots=True)
class Throughput:
    """What was measured, the last few of each kind, the newest last.

    `measured` are bytes per second of the ports, by kind of loader. `steps` are seconds by kind of step
    (`cm.manager.state.steps`) beside what a port takes for an image: reading files, the kernel's drivers, the
    record. What is expected is their median: a single one that was disturbed, as the first after a start is by cold
    caches, says nothing about the next. Of two, the quicker counts, and beside a single load the port's nominal rate.
    """

    measured: Mapping[LoaderKind, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))
    steps: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: MappingProxyType({}))

    def rate(self, loader: LoaderKind) -> float:
        """Bytes per second to expect."""
        rates = self.measured.get(loader, ())
        known = sorted(rates if len(rates) > 1 else (*rates, _NOMINAL[loader]))
        return known[len(known) // 2]

    def seconds(self, loader: LoaderKind, length: int) -> float:
        """Expected duration of a load of `length` bytes."""
        return length / self.rate(loader)

    def overhead(self, step: str) -> float:
        """Expected seconds of a kind of step beside the port; 0 before it was measured."""
        known = sorted(self.steps.get(step) or (0.0,))
        return known[(len(known) - 1) // 2]

    def timeout(self, region: Region, length: int) -> float:
        """Seconds after which a load counts as hung: the schema's, else from size and throughput."""
        if region.timeout is not None:
            return region.timeout
        return _GRACE + _MARGIN * self.seconds(region.loader, length)

    def observed(self, loader: LoaderKind, length: int, seconds: float) -> Throughput:
        """With one more load."""
        if seconds <= 0 or length <= 0:
            return self
        rates = _with(self.measured.get(loader, ()), length / seconds)
        return Throughput(MappingProxyType({**self.measured, loader: rates}), self.steps)

    def took(self, *more: tuple[str, float]) -> Throughput:
        """With more steps: their kinds, and the seconds without the time of the port in them."""
        steps = {**self.steps}
        for step, seconds in more:
            steps[step] = _with(steps.get(step, ()), seconds)
        return Throughput(self.measured, MappingProxyType(steps))


def _with(before: tuple[float, ...], new: float) -> tuple[float, ...]:
    return (*before, float(f"{new:.4g}"))[-_RECENT:]  # recorded before every step, so without digits that mean nothing


@dataclass(frozen=True, slots=True)
class Pending:
    """A change under way: where it goes, where it came from, and the step it was about to take."""

    number: int
    config: str
    mode: str
    from_config: str | None
    from_mode: str | None
    step: str = ""
    subject: str = ""
    overlay: str | None = None  # being applied or removed
    from_static: str | None = None  # the full configuration whose image the device held
    held: Mapping[str, str] = field(default_factory=dict)  # modules of the regions that were ready before it
    values: Mapping[str, int] = field(default_factory=dict)  # registers as they were before it, for the way back
    found: tuple[tuple[int, int, int], ...] = ()  # others: physical address, width and value
    rates: Mapping[str, int] = field(default_factory=dict)  # clocks, in Hz, likewise
    touched: bool = False  # whether anything of the board may differ for it
    begun: tuple[str, ...] = ()  # regions whose load has begun, there or on the way back
    locked: tuple[str, ...] = ()  # regions whose registers no client has written since, likewise


@dataclass(frozen=True, slots=True)
class WayBack:
    """What it takes to undo the last change: who asked for that gave it the name."""

    name: str
    change: Pending


@dataclass(frozen=True, slots=True)
class Record:
    """One line of the journal."""

    boot_id: str
    state: BoardState
    pending: Pending | None = None
    throughput: Throughput = field(default_factory=Throughput)
    number: int = 0  # of the last change
    way_back: WayBack | None = None


class OtherVersion(ValueError):
    """A whole line that another version of this program wrote."""


class Damaged(ValueError):
    """A line that is not what was written, after the last good one."""


class Kept(Generic[_T]):
    """The last result of a function, true as long as its inputs are the same objects. Any thread."""

    __slots__ = ("_last", "_make")

    def __init__(self, make: Callable[..., _T]) -> None:
        self._make = make
        self._last: tuple[tuple[object, ...], _T | None] = ((), None)

    def of(self, *things: object) -> _T:
        """`make` of them, not None."""
        before, made = self._last
        if made is None or not all(map(is_, things, before)):
            made = self._make(*things)
            self._last = things, made
        return made


class Texts:
    """JSON of immutable parts of a record, kept until others stand in their place: most stay for many records."""

    def __init__(self) -> None:
        self._begin, self._values = Kept(_begin), Kept(_values)
        self._changes = (Kept(_change_begin), Kept(_change_rest)), (Kept(_change_begin), Kept(_change_rest))
        self._measured = Kept(_all_measured)

    def of(self, r: Record) -> str:
        """An object."""
        s = r.state
        static = s.static_sha256, s.static_config, s.static_lost
        begin = self._begin.of(r.boot_id, r.number, s.config, s.mode, s.schema, *static, s.regions, s.overlays)
        values = self._values.of(s.values, s.clocks)
        pending, back = "null", ""
        if r.pending is not None:
            pending = _change(r.pending, *self._changes[0])
        if r.way_back is not None:
            back = f',"way_back":[{_json(r.way_back.name)},{_change(r.way_back.change, *self._changes[1])}]'
        return f'{{{begin},{values}}},"pending":{pending}{back},{self._measured.of(r.throughput)}}}'


def _change(x: Pending, begin: Kept[str], rest: Kept[str]) -> str:
    """An object; all but the step stays as it is."""
    text = begin.of(x.number, x.config, x.mode, x.from_config, x.from_mode)
    overlay = "null" if x.overlay is None else _json(x.overlay)
    step = f'"step":{_json(x.step)},"subject":{_json(x.subject)},"overlay":{overlay}'
    left = f'"touched":{"true" if x.touched else "false"},"begun":{_names(x.begun)}'
    return f"{{{text},{step},{left},{rest.of(x.from_static, x.held, x.values, x.found, x.rates, x.locked)}}}"


@lru_cache(64)
def _names(names: tuple[str, ...]) -> str:
    """A list. Cached: it is in each record of a change, which seldom adds to it."""
    return _json(names)


def encode(record: Record, texts: Texts) -> bytes:
    """A line; it begins with a line end, so that a torn line before it does no harm."""
    body = texts.of(record).encode()
    return b"\n%08x %b\n" % (zlib.crc32(body), body)


def _members(plain: Mapping[str, Any]) -> str:
    return _json(plain)[1:-1]


def _begin(
    boot_id: str,
    number: int,
    config: str | None,
    mode: str | None,
    schema: str,
    static_sha256: str | None,
    static_config: str | None,
    static_lost: bool,
    regions: Mapping[str, RegionState],
    overlays: tuple[OverlayState, ...],
) -> str:
    state = {
        "config": config,
        "mode": mode,
        "schema": schema,
        "static": [static_sha256, static_config, static_lost],
        "regions": {n: [x.phase.value, x.module, x.sha256] for n, x in regions.items()},
        "overlays": [[o.name, o.sha256] for o in overlays],
    }
    return _members({"version": _VERSION, "boot_id": boot_id, "number": number, "state": state})[:-1]


def _values(values: Mapping[str, int], clocks: Mapping[str, int]) -> str:
    return _members({"values": {**values}, "clocks": {**clocks}})


def _change_begin(number: int, config: str, mode: str, from_config: str | None, from_mode: str | None) -> str:
    return _members(
        {"number": number, "config": config, "mode": mode, "from_config": from_config, "from_mode": from_mode}
    )


def _change_rest(
    static: str | None,
    held: Mapping[str, str],
    values: Mapping[str, int],
    found: object,
    rates: Mapping[str, int],
    locked: tuple[str, ...],
) -> str:
    before = {"from_static": static, "held": {**held}, "values": {**values}, "found": found, "rates": {**rates}}
    return _members({**before, "locked": locked})


def _all_measured(known: Throughput) -> str:
    rates = ",".join([_measured(kind.value, rates) for kind, rates in known.measured.items()])
    seconds = ",".join([_measured(kind, took) for kind, took in known.steps.items()])
    return f'"throughput":{{{rates}}},"seconds":{{{seconds}}}'


@lru_cache(64)
def _measured(kind: str, values: tuple[float, ...]) -> str:
    """Measurements of a kind.

    Cached, as few are new in each record, and formatting all would take longer than the rest of it.
    """
    return f"{_json(kind)}:{_json(values)}"


def newest(data: bytes) -> Record | None:
    """The last whole line; None where there is none. A line without its end is one that a kill has cut: it does not
    count, as its step was not taken.

    Raises OtherVersion, and Damaged: the newest line counts, or none, as those before it are no longer true.
    """
    *lines, torn = data.rstrip(b"\0").split(b"\n")
    for line in reversed(lines):
        body = _checked(line)
        if body is not None:
            return _understood(body)
        if line:
            raise Damaged
    if torn:
        raise Damaged
    return None


def _checked(line: bytes) -> bytes | None:
    """The body of a line whose CRC is right."""
    crc, space, body = line.partition(b" ")
    try:
        return body if space and int(crc, 16) == zlib.crc32(body) else None
    except ValueError:
        return None


def _understood(body: bytes) -> Record:
    try:
        return _from_plain(json.loads(body))
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError):
        raise OtherVersion from None


def _pending_from_plain(plain: Mapping[str, Any]) -> Pending:
    found = tuple((int(a), int(w), int(v)) for a, w, v in plain["found"])
    begun, locked = tuple(plain["begun"]), tuple(plain.get("locked", ()))
    return Pending(**{**plain, "found": found, "begun": begun, "locked": locked})


def _from_plain(plain: Mapping[str, Any]) -> Record:
    """Raises ValueError, KeyError, TypeError, IndexError or AttributeError for what is not of this version."""
    if plain["version"] != _VERSION:
        raise ValueError(plain["version"])
    state = plain["state"]
    back = plain.get("way_back")
    return Record(
        boot_id=plain["boot_id"],
        number=plain["number"],
        state=BoardState(
            config=state["config"],
            mode=state["mode"],
            schema=state["schema"],
            static_sha256=state["static"][0],
            static_config=state["static"][1],
            static_lost=state["static"][2],
            regions=MappingProxyType(
                {n: RegionState(RegionPhase(p), m, h) for n, (p, m, h) in state["regions"].items()}
            ),
            overlays=tuple(OverlayState(n, h) for n, h in state["overlays"]),
            values=MappingProxyType(dict(state["values"])),
            clocks=MappingProxyType(dict(state["clocks"])),
        ),
        pending=None if plain["pending"] is None else _pending_from_plain(plain["pending"]),
        throughput=Throughput(
            MappingProxyType({LoaderKind(k): tuple(map(float, v)) for k, v in plain["throughput"].items()}),
            MappingProxyType({str(k): tuple(map(float, v)) for k, v in plain["seconds"].items()}),
        ),
        way_back=None if back is None else WayBack(back[0], _pending_from_plain(back[1])),
    )


__all__ = ["Journal", "Pending", "Record"]

LENGTH = 256 * 1024  # bytes of a journal
_DISK = (errno.EROFS, errno.EIO, errno.ENOSPC, errno.EDQUOT)  # no reason not to serve


class Journal:
    """The journal in a folder, which it holds a lock on. Raises StateInUse, OSError.

    One that the disk lets nobody write is read all the same; then `write` says why.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path = folder / "journal"
        self._lock = _locked(folder)
        self._spare = -1
        self._texts = Texts()
        self._fd, self._cut = -1, False
        try:
            self._begin()
        except OSError as error:
            if error.errno not in _DISK:
                os.close(self._lock)
                raise

    def _begin(self) -> None:
        self._cut = self._path.is_file() and 0 < self._path.stat().st_size < LENGTH
        self._at = _end(self._path)  # where the next line goes
        self._fd = _opened(self._path)
        with contextlib.suppress(OSError):
            self._old.unlink(missing_ok=True)
        self._renew_spare()

    def write(self, record: Record) -> None:
        """Add a record; it survives the death of this process from here on. Raises OSError."""
        line = encode(record, self._texts)
        try:
            if self._fd < 0:
                self._begin()
            if self._at + len(line) > LENGTH:
                self._rotate(line)
            else:
                self._put(self._fd, line, self._at)
                self._at += len(line)
        except OSError as error:  # a descriptor has no name to tell
            raise OSError(error.errno, error.strerror, str(self._path)) from None

    def _put(self, descriptor: int, line: bytes, at: int) -> None:
        if os.pwrite(descriptor, line, at) != len(line):
            raise OSError(errno.ENOSPC, "it was not written whole: is the disk full?")

    def _rotate(self, line: bytes) -> None:
        if self._spare < 0:
            self._spare = _opened(self._new, empty=True)
        self._put(self._spare, line, 0)
        kept = self._keep_old()
        self._new.replace(self._path)
        old, self._fd, self._spare = self._fd, self._spare, -1
        self._at = len(line)
        self._renew_spare(old if kept else -1)
        if self._spare != old:
            os.close(old)

    def _keep_old(self) -> bool:
        """Give the journal a second name, so that its space is not lost to others when the first name goes."""
        with contextlib.suppress(OSError):
            os.link(self._path, self._old)
            return True
        return False

    def _renew_spare(self, old: int = -1) -> None:
        """A file of full length, to be the next journal: the old one, or a new one.

        Without room for it, it is tried again when it is needed.
        """
        with contextlib.suppress(OSError):
            if old >= 0:
                self._old.replace(self._new)
                os.ftruncate(old, LENGTH)
                self._put(old, bytes(LENGTH), 0)  # an old line must not stand behind a new one
                self._spare = old
                return
            self._spare = _opened(self._new, empty=True)

    @property
    def _new(self) -> Path:
        return self._path.with_suffix(".new")

    @property
    def _old(self) -> Path:
        return self._path.with_suffix(".old")

    def read(self) -> Record | None:
        """The last whole record; None if there is none yet.

        Raises StoreCorrupt where the file cannot be read, its end was damaged or cut off, or its last line is of
        another version; it is set aside first.
        """
        try:
            if self._cut:
                raise Damaged
            return newest(self._path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StoreCorrupt(f"the state record {self._path} cannot be read ({error})") from error
        except Damaged:
            what = "is damaged or cut off at its end, so what it said last is not known"
        except OtherVersion:
            what = "is of another version of this program"
        raise StoreCorrupt(f"the state record {self._path} {what}; {self._aside()}")

    def _aside(self) -> str:
        """Begin a new journal; returns a sentence on what became of the old one."""
        aside = self._path.with_suffix(".corrupt")
        try:
            self._path.replace(aside)
            new = _opened(self._path)
        except OSError as error:
            return f"it could not be set aside ({error})"
        if self._fd >= 0:
            os.close(self._fd)
        self._fd, self._at, self._cut = new, 0, False
        return f"it was moved to {aside}"

    def close(self) -> None:
        """Close the files and give the lock back; twice is fine."""
        for descriptor in (self._fd, self._spare, self._lock):
            if descriptor >= 0:
                os.close(descriptor)
        self._fd = self._spare = self._lock = -1


def _opened(path: Path, empty: bool = False) -> int:
    """A journal, of its full length, with room for that as far as the file system can promise it. Raises OSError."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        if empty:
            os.ftruncate(descriptor, 0)
        os.ftruncate(descriptor, LENGTH)
    except OSError:
        os.close(descriptor)
        raise
    with contextlib.suppress(OSError):
        os.posix_fallocate(descriptor, 0, LENGTH)
    return descriptor


def _end(path: Path) -> int:
    try:
        return len(path.read_bytes().rstrip(b"\0"))
    except OSError:  # `read` will say so; what is written next goes to a new file
        return LENGTH


def _locked(folder: Path) -> int:
    """An flock on the folder: it ends with the process, however that dies. Raises StateInUse."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            raise
        raise StateInUse(
            f"another configuration manager keeps its state in {folder}; stop it, or choose another --state-dir"
        ) from None
    return descriptor


@dataclass(frozen=True, slots=True)
class LockedRegions:
    """What a running change has locked against requests: regions, or the whole device."""

    regions: frozenset[str] = frozenset()
    whole: bool = False

    def __contains__(self, region: object) -> bool:
        return self.whole or region in self.regions


class ManagerState:
    """What the manager knows, and its record on disk."""

    def __init__(self, configs: Mapping[str, Config], journal: Journal) -> None:
        self.configs: Mapping[str, Config] = MappingProxyType(dict(configs))  # all that can be loaded
        self.latest = BoardState()  # what the board holds, except for `_written`
        self.throughput = Throughput()
        self.choices: Mapping[tuple[str, str], Choice] = MappingProxyType({})  # by configuration and region
        self.lock = threading.RLock()
        self.pending: Pending | None = None  # the change under way
        self.way_back: WayBack | None = None  # of the last change, where its requester wanted it kept
        self.locked = LockedRegions()
        self.taken = ""  # a sentence on what another program has loaded, until a configuration is entered
        # From now on names may lead elsewhere; called under the lock, or from the thread of requests.
        self.moved: Callable[[], None] = lambda: None
        self.runtime_memories: Mapping[str, Memory] = MappingProxyType(
            {}
        )  # defined at run time, for this configuration
        self._journal = journal
        self._boot_id = ""
        self._number = 0
        self.generation = 0  # of the registers
        self._recorded: Record | None = None  # the last one that was written
        self._under_way: Pending | None = None  # what a record of now says beside the board
        self._disk_says: Pending | None = None  # what the last one that was written or found says
        self.overtaken = False  # that change is over, and no record could say so
        self._took: list[tuple[str, float]] = []  # by steps of the change that runs
        self._dirty = False
        self.urgent = False  # something was noted that is nowhere but here
        self._written: dict[str, int] = {}  # registers that were written since `latest` was made

    @property
    def board(self) -> BoardState:
        """What the board holds, as far as is known; replaced by `update`."""
        if self._written:
            with self.lock:
                values = MappingProxyType({**self.latest.values, **self._written})
                self.latest, self._written = replace(self.latest, values=values), {}
        return self.latest

    def note_written(self, register: str, value: int, only_here: bool = False) -> None:
        """Remember a register's written value; its cost does not grow with what is remembered.

        `only_here`: nobody can read it back from the hardware, so it has to be on disk before its write is confirmed.
        """
        with self.lock:
            self._written[register] = value
            self._dirty = True
            if only_here:
                self.urgent = True

    def written(self) -> int:
        """All noted values are in the registers; returns the number of this generation of them."""
        with self.lock:
            self.generation += 1
            return self.generation

    def note_found(self, place: Place, value: int) -> None:
        """Remember what a register held before the change that runs, for the way back after a crash."""
        with self.lock:
            if self.pending is not None:
                self.pending = replace(self.pending, found=(*self.pending.found, (*place, value)))

    def note_load(self, region: str) -> None:
        """A region's load begins, which the next record says."""
        with self.lock:
            if self.pending is not None and region not in self.pending.begun:
                self.pending = replace(self.pending, begun=(*self.pending.begun, region))

    def written_value(self, register: str) -> int | None:
        """What was last written to a register since its region was loaded."""
        with self.lock:
            value = self._written.get(register)
            return self.latest.values.get(register) if value is None else value

    def loaded_config(self) -> Config | None:
        """The configuration that is loaded."""
        name = self.latest.config
        return self.configs.get(name) if name else None

    def add_config(self, config: Config) -> None:
        """Make a configuration known, in place of one of its name."""
        self.configs = MappingProxyType({**self.configs, config.name: config})
        if config.name == self.latest.config:
            self.runtime_memories = MappingProxyType({})
        self.moved()

    def forget_config(self, name: str) -> None:
        """Make a configuration unknown."""
        self.configs = MappingProxyType({known: config for known, config in self.configs.items() if known != name})
        self.moved()

    def choose(self, config: str, choices: Mapping[str, Choice]) -> None:
        """Keep which ports load the regions of a configuration whose schema leaves that open."""
        if choices:
            self.choices = MappingProxyType({**self.choices, **{(config, name): c for name, c in choices.items()}})

    def next_number(self) -> int:
        """The number of a new change."""
        self._number += 1
        return self._number

    def update(self, change: Callable[[BoardState], BoardState]) -> None:
        """Replace the state in one piece; both threads do."""
        with self.lock:
            before = self.board
            after = self.latest = change(before)
            if after.config != before.config:
                self.runtime_memories = MappingProxyType({})
                self.taken = "" if after.config else self.taken
            if after.regions is not before.regions or after.mode != before.mode or after.config != before.config:
                self.moved()

    def lock_regions(self, regions: frozenset[str], whole: bool = False) -> None:
        """Lock these regions' registers, or all, against requests; waits for an access under way."""
        with self.lock:
            self.locked = LockedRegions(regions, whole)
            if self.pending is not None and not regions.issubset(self.pending.locked):
                self.pending = replace(self.pending, locked=tuple(sorted(regions.union(self.pending.locked))))
            self.moved()

    def release_regions(self) -> None:
        """Requests may access what they could before."""
        self.lock_regions(frozenset())

    def define(self, memory: Memory) -> None:
        """Make a memory known until the configuration changes, in place of one of its name."""
        with self.lock:
            self.runtime_memories = MappingProxyType({**self.runtime_memories, memory.name: memory})

    def observed(self, kind: LoaderKind, length: int, seconds: float) -> None:
        """Keep a measurement for plans and time-outs."""
        self.throughput = self.throughput.observed(kind, length, seconds)

    def took(self, step: str, seconds: float, port_seconds: float) -> None:
        """Keep how long a kind of step took, without the time of the port; `keep_times` makes use of it."""
        with self.lock:
            self._took.append((step, seconds - port_seconds))

    # ---- the record ----------------------------------------------------------------

    def read_record(self) -> tuple[Record | None, str]:
        """The record, and a sentence where it was not readable: then nothing is known, which is no reason to stop."""
        try:
            return self._journal.read(), ""
        except StoreCorrupt as error:
            return None, str(error)

    def adopt(self, record: Record | None, board: BoardState, boot_id: str) -> None:
        """Begin with what was found at start: what the board holds, and what the record says beside it."""
        self.latest, self._written, self._boot_id = board, {}, boot_id
        self.moved()
        self.way_back = record.way_back if record is not None and record.boot_id == boot_id else None
        self.runtime_memories = MappingProxyType({})
        self._under_way = self._disk_says = None
        if record is not None:
            self.throughput, self._number = record.throughput, record.number
            self._disk_says = record.pending if record.boot_id == boot_id else None

    def record(self, step: Step | None) -> None:
        """Write the state and the step about to be taken, or that no change is under way. Raises RecordFailed."""
        with self.lock:
            if self.pending is not None and step is not None:
                self.pending = _about_to(self.pending, step)
            self._write(None if step is None else self.pending)

    def _write(self, pending: Pending | None, again: bool = True) -> None:
        self._under_way = pending
        known = Record(self._boot_id, self.board, pending, self.throughput, self._number, self.way_back)
        if not again and known == self._recorded:
            return
        try:
            self._journal.write(known)
        except OSError as error:
            self.overtaken = pending is None and self._disk_says is not None
            raise RecordFailed(f"the state record could not be written: {sentence(error)}") from error
        self._recorded, self._disk_says, self._dirty, self.urgent = known, pending, False, False
        self.overtaken = False

    def check_kept(self) -> None:
        """Raise RecordFailed where a start from the last record would undo a write to a register or a memory.

        That record is then of a change that is over: its regions are loaded again, with the values from before it.
        """
        if self.overtaken and (problem := self.try_record()) is not None:
            raise RecordFailed(f"nothing was written, as a restart would undo it: {problem.message}")

    def try_record(self, under_way: Pending | None = None) -> ErrorInfo | None:
        """Write what the board holds, and that no other change is under way; what went wrong, if that failed."""
        return self._tried(under_way)

    def settle(self) -> ErrorInfo | None:
        """The same, unless the last record says just what this one would."""
        return self._tried(None, again=False)

    def keep_times(self) -> None:
        """Use how long steps took for plans from now on; the next `flush` records it, as nobody waits for that."""
        with self.lock:
            self.throughput, self._took = self.throughput.took(*self._took), []
            self._dirty = True

    def flush(self) -> ErrorInfo | None:
        """Write what was noted since the last record; a change that runs meanwhile stays under way."""
        self.urgent = False
        return self._tried(self._under_way) if self._dirty else None

    def _tried(self, pending: Pending | None, again: bool = True) -> ErrorInfo | None:
        try:
            with self.lock:
                self._write(pending, again)
        except RecordFailed as problem:
            return ErrorInfo(problem.code, str(problem))
        return None


def _about_to(pending: Pending, step: Step) -> Pending:
    rates = pending.rates
    if isinstance(step, SetClock) and step.before:
        rates = {step.clock.name: step.before, **rates}
    overlay = None
    if isinstance(step, ApplyOverlay):
        overlay = step.overlay.name
    elif isinstance(step, RemoveOverlay):
        overlay = step.name
    touched = pending.touched or not isinstance(step, Validate | CheckStatic)
    return replace(pending, step=step.kind, subject=step.subject, overlay=overlay, rates=rates, touched=touched)

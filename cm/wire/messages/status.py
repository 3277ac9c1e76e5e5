# SPDX-License-Identifier: Apache-2.0
"""What the configuration manager tells: its status, events and the bodies of replies.

Objects that are made for every control request are named tuples: a frozen dataclass takes twice as long to make.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, NamedTuple

from cm.frozen import dataclass

PIXEL_FORMAT = "pixel_format"  # the code of a picture's refusal, whose pixels the client then brings in order
NOTICES = ("reconciled", "slept")  # codes of what the manager has found out, where nothing failed


def place(config: str, mode: str | None) -> str:
    """A mode of a configuration for people, or that it is in none."""
    return f"{config}/{mode or 'no mode'}"


class PrMode(str, Enum):
    """What kind of reconfiguration runs, or how the last one ended."""

    IDLE = "idle"
    PARTIAL = "partial"
    FULL = "full"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class ErrorInfo:
    """An error as it travels: a stable code and a sentence."""

    code: str
    message: str


@dataclass(frozen=True, slots=True)
class Progress:
    """Where a running change is; `fraction` is 0 to 1 over the whole change."""

    change: int
    target_config: str
    target_mode: str
    step: str = ""
    subject: str = ""
    bytes_done: int = 0
    bytes_total: int = 0
    fraction: float = 0.0


@dataclass(frozen=True, slots=True)
class RegionHealth:
    """What checks of a region have found, since the manager's start."""

    checks: int = 0  # that went over all of it
    upsets: int = 0  # bits that were found wrong, each once
    repairs: int = 0
    wrong_bits: int = 0  # by the last check; 0 once it was repaired or loaded again
    frames: int = 0  # that the last check has compared
    unjudged: int = 0  # and those that it could not
    checked_ns: int = 0  # CLOCK_MONOTONIC at the last check's end; 0: none since it was loaded


@dataclass(frozen=True, slots=True)
class RegionStatus:
    """A region: the module in it (None: unknown or none) and its state."""

    name: str
    module: str | None
    state: str
    loader: str = ""  # the port of `loader: auto`: icap, or fpga_manager with the reason; else empty
    health: RegionHealth | None = None  # once it was checked


@dataclass(frozen=True, slots=True)
class FrameError:
    """A frame that does not hold what was loaded, by its address; `bits`: 32 times the word, and the bit in it."""

    far: int
    block_type: int
    row: int
    column: int
    minor: int
    bits: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class RegionCheck:
    """What a region holds, compared with what was loaded into it.

    `verdict`: good, wrong, or unjudged where not a frame could be compared. `frames` were compared, `unjudged` could
    not be; `why` says why, and how it is known which bits the fabric itself changes. `wrong`: at most 256 frames with
    64 bits each, `wrong_frames` and `wrong_bits` count all. `repaired`: "frames" or "load", and then the verdict is
    that of the check after it, the wrong frames those that were found before.
    """

    region: str
    module: str
    verdict: str
    frames: int = 0
    unjudged: int = 0
    why: str = ""
    wrong_frames: int = 0
    wrong_bits: int = 0
    wrong: tuple[FrameError, ...] = ()
    repaired: str = ""
    seconds: float = 0.0
    change: int = 0  # number of the change that repaired it, or looked whether that is needed
    config_name: str = ""
    mode: str = ""


class RegionColumn(NamedTuple):
    """Set bits of a column of frames, without checksums: of each frame, of each row of tiles, of the clock row.

    `far`: the address of the first frame. `switches` and `logic`: of 50 rows from the bottom up.
    """

    far: int
    bits: tuple[int, ...]
    switches: tuple[int, ...]
    logic: tuple[int, ...]
    clock: int


@dataclass(frozen=True, slots=True)
class RegionMap:
    """What was loaded into a region of a 7-series device, counted.

    `wrong` is what the last check has found, as far as it lists it, `checked` the seconds since then; 0 where there was
    none since the module was loaded.
    """

    region: str
    module: str
    device: str
    config_name: str
    columns: tuple[RegionColumn, ...] = ()
    wrong: tuple[FrameError, ...] = ()
    checked: float = 0.0


@dataclass(frozen=True, slots=True)
class ClockStatus:
    """A clock: the rate that the configuration wants and the one it has or will have (0: not known), in Hz."""

    name: str
    wanted: int
    rate: int = 0


@dataclass(frozen=True, slots=True)
class SensorStatus:
    """What a sensor of the board measured last: `value` in °C, V, A or W by `quantity`.

    `quantity`: temperature, voltage, current or power. `device`: as its driver calls it.
    """

    device: str
    name: str
    quantity: str
    value: float


@dataclass(frozen=True, slots=True)
class StreamClient:
    """A client of a stream on the manager's machine: its process, and what it got since it was attached. `frames`:

    lent to it, or sent by it. `dropped`: lost to it because it held all the slots it may hold, or did not read.
    """

    pid: int
    name: str = ""
    writes: bool = False
    depth: int = 0
    held: int = 0
    frames: int = 0
    dropped: int = 0


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """A stream as it is configured now, and its counters since it was opened."""

    name: str
    channel: str
    direction: str
    shape: tuple[int, ...] = ()
    dtype: str = "uint8"
    slots: int = 0  # frame buffers that it has; while it is closed: those it begins with, as they were set
    open: bool = False
    frames: int = 0
    dropped: int = 0
    errors: int = 0
    rate: float = 0.0
    latency_us: float = 0.0
    clients: tuple[StreamClient, ...] = ()
    overruns: int = 0  # times that a subscriber over ZeroMQ began to lose frames
    cyclic: bool = False
    backpressure: bool = False
    stride: int = 0  # bytes from line to line in memory; 0: lines follow each other
    limit: float = 0.0  # frames handed on per second at most; 0: all
    exact: bool = False  # the channel cannot tell how many bytes arrived: each frame must end with TLAST; while open
    max_length: int = 0  # bytes of one transfer at most; 0 while the stream is closed
    last_error: ErrorInfo | None = None  # why it last failed, or lost a transfer, in this mode
    format: str = ""  # of its pixels in memory
    slot_bytes: int = 0  # of a frame at most, as it is in memory; of a closed stream: as the schema says, or 0


@dataclass(frozen=True, slots=True)
class LeaseStatus:
    """A lease that is held, as all may see it: only its holder knows its id. `seconds` until it ends unless renewed."""

    number: int  # the number by which it can be broken
    scope: str
    exclusive: bool = True
    holder: str = ""
    client: str = ""  # the client that took it, as the manager knows it
    pid: int = 0  # the process with whose end it ends
    seconds: float = 0.0


class WindowStatus(NamedTuple):
    """Pages of registers that a client has mapped, until it gives them back or the manager takes them."""

    number: int
    region: str  # "static": outside all regions
    module: str
    address: int  # physical, of the first page
    length: int
    writes: bool = False
    exclusive: bool = False  # a lease on the region goes with it
    client: str = ""
    pid: int = 0


@dataclass(frozen=True, slots=True)
class ClientStatus:
    """What one client uses of what all share."""

    name: str
    connections: int = 0
    leases: int = 0
    slots: int = 0
    upload_bytes: int = 0
    waiting_bytes: int = 0  # of requests that wait, and of replies that it has not read
    requests: int = 0
    refused: int = 0
    account: str = ""  # to which it belongs: a user, a key, or an address
    waiting: int = 0  # requests that came, and wait for their turn
    memory_bytes: int = 0  # for masters in the PL
    unread_bytes: int = 0  # of `waiting_bytes`, replies that it has not read


@dataclass(frozen=True, slots=True)
class StepTaken:
    """A step of a change; `port_seconds` of its `seconds` are the configuration port's. `back`: on the way back."""

    kind: str
    subject: str
    begun_ns: int  # CLOCK_MONOTONIC
    seconds: float = 0.0
    port_seconds: float = 0.0
    failed: bool = False
    back: bool = False


@dataclass(frozen=True, slots=True)
class PastChange:
    """A change that has run, or runs (`ended_ns` is 0), with its steps; times are CLOCK_MONOTONIC.

    `by` asked for it; empty: nobody. `why`: of one that nobody asked for, or that undoes or repairs something.
    """

    number: int
    config_name: str
    mode: str
    from_config: str = ""
    from_mode: str = ""
    by: str = ""
    why: str = ""
    begun_ns: int = 0
    ended_ns: int = 0
    error: ErrorInfo | None = None
    steps: tuple[StepTaken, ...] = ()


@dataclass(frozen=True, slots=True)
class PastWrite:
    """The last write of a register by a client, and its whole value after it."""

    name: str
    value: int
    by: str
    at_ns: int  # CLOCK_MONOTONIC


@dataclass(frozen=True, slots=True)
class Status:
    """The state of the PL as the manager knows it: the content of ``cm_status``."""

    config_name: str = ""
    mode: str = ""
    fpga_busy: bool = False
    pr_mode: PrMode = PrMode.IDLE
    progress: Progress | None = None
    sequence: int = 0
    last_error: ErrorInfo | None = None
    regions: tuple[RegionStatus, ...] = ()
    streams: tuple[StreamStatus, ...] = ()
    configs: tuple[str, ...] = ()
    version: str = ""
    started_ns: int = 0
    last_change: int = 0
    last_change_seconds: float = 0.0
    clocks: tuple[ClockStatus, ...] = ()
    board: str = ""  # the board's name
    realtime_offset_ns: int = 0  # CLOCK_REALTIME less CLOCK_MONOTONIC of the manager's machine
    generation: int = 0  # of the registers: grows with every write by a request, and with every change
    sensors: tuple[SensorStatus, ...] = ()  # of the board; within the last seconds
    leases: tuple[LeaseStatus, ...] = ()
    clients: tuple[ClientStatus, ...] = ()  # only in the reply to a request for them
    windows: tuple[WindowStatus, ...] = ()
    last_change_ns: int = 0  # CLOCK_MONOTONIC at its end; 0: there was none since the manager's start
    changes: tuple[PastChange, ...] = ()  # this and the next only in the reply to a request for the history
    writes: tuple[PastWrite, ...] = ()

    def __str__(self) -> str:
        """What people look for first, in a few lines."""
        loaded = place(self.config_name, self.mode) if self.config_name else "nothing loaded"
        goes_on = f", {self.progress.step} {self.progress.subject}".rstrip() if self.progress is not None else ""
        lines = [f"{self.board or 'board'}: {loaded}, {self.pr_mode.value}{goes_on}"]
        if self.last_error is not None:
            lines.append(f"last error: {self.last_error.message} [{self.last_error.code}]")
        if self.regions:
            lines.append("regions: " + ", ".join(f"{r.name} {r.module or '-'} ({r.state})" for r in self.regions))
        flowing = ", ".join(f"{s.name} {s.rate:.1f}/s" if s.open else f"{s.name} closed" for s in self.streams)
        return "\n".join([*lines, *([f"streams: {flowing}"] if flowing else [])])

    def _repr_pretty_(self, printer: Any, cycle: bool) -> None:  # noqa: ARG002 (IPython's)
        printer.text(str(self))

    def _repr_html_(self) -> str:
        from cm.wire.messages import notebook  # only notebooks need it

        return notebook.status(self)


class RegValue(NamedTuple):
    """A register's value and those of its fields."""

    name: str
    value: int
    fields: tuple[tuple[str, int], ...] = ()


class RegValues(NamedTuple):
    """Registers' values, and the mode they were read in."""

    values: tuple[RegValue, ...]
    config_name: str = ""
    mode: str = ""
    generation: int = 0  # of what was written; 0 beside values that were read


@dataclass(frozen=True, slots=True)
class FieldInfo:
    """A field of a register."""

    name: str
    lsb: int
    width: int
    doc: str = ""
    values: tuple[tuple[str, int], ...] = ()  # names of values
    access: str = ""  # as in the runtime schema; empty: as the register


@dataclass(frozen=True, slots=True)
class RegisterInfo:
    """A register as the schema describes it; `modes` is empty if all modes have it."""

    name: str
    address: int
    width: int
    access: str
    default: int | None = None
    minimum: int | None = None
    maximum: int | None = None
    doc: str = ""
    fields: tuple[FieldInfo, ...] = ()
    modes: tuple[str, ...] = ()
    region: str = ""
    type: str = ""  # what the bits mean: int, float32 or float64; empty: uint
    fraction: int = 0  # bits of a uint or int behind the binary point


@dataclass(frozen=True, slots=True)
class MemoryInfo:
    """A memory: `size` bytes at `address`; `modes` is empty if all have it; `defined`: by a client, at run time."""

    name: str
    address: int
    size: int
    access: str = "rw"
    dtype: str = "uint32"
    shape: tuple[int, ...] = ()  # empty: one axis of as many elements as fit
    region: str = ""
    doc: str = ""
    modes: tuple[str, ...] = ()
    defined: bool = False


@dataclass(frozen=True, slots=True)
class BlockInfo:
    """An IP of the static part: `size` bytes at `base_address`; its registers' names begin with `prefix`."""

    name: str
    base_address: int
    size: int
    vlnv: str = ""
    prefix: str = ""
    interrupts: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    doc: str = ""


@dataclass(frozen=True, slots=True)
class ModeInfo:
    """A mode: what it consists of, by name."""

    name: str
    modules: tuple[str, ...] = ()
    registers: tuple[str, ...] = ()
    overlays: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InterruptInfo:
    """A named interrupt and how often it came since the configuration was loaded."""

    name: str
    doc: str = ""
    count: int = 0


@dataclass(frozen=True, slots=True)
class ConfigEntry:
    """A configuration in the list of all; `default_mode` is the one that is loaded if none is named."""

    name: str
    type: str = ""
    modes: tuple[str, ...] = ()
    default_mode: str = ""
    origin: str = ""  # "administrator" or "client"
    owner: str = ""  # for a client's: who sent it
    bytes: int = 0  # for a client's: the bytes of all its files


@dataclass(frozen=True, slots=True)
class ConfigInfo:
    """A configuration's description; `mode` is empty while it is not loaded."""

    name: str = ""
    type: str = ""
    mode: str = ""
    modes: tuple[ModeInfo, ...] = ()
    registers: tuple[RegisterInfo, ...] = ()
    interrupts: tuple[InterruptInfo, ...] = ()
    streams: tuple[StreamStatus, ...] = ()
    names: tuple[str, ...] = ()
    schema: str = ""
    memories: tuple[MemoryInfo, ...] = ()
    entries: tuple[ConfigEntry, ...] = ()  # in a list of all configurations
    blocks: tuple[BlockInfo, ...] = ()


@dataclass(frozen=True, slots=True)
class PlanStep:
    """One step of a plan: what it does to what, and how long it should take (seconds)."""

    kind: str
    subject: str
    text: str
    bytes: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class PlanInfo:
    """What going to a mode would do; nothing was touched to find out."""

    config_name: str
    mode: str
    steps: tuple[PlanStep, ...]
    bytes: int
    seconds: float
    clocks: tuple[ClockStatus, ...] = ()  # that would be set

    def __str__(self) -> str:
        """A line for each step."""
        steps = [f"{i:2} {s.text}{f' ({s.bytes} bytes)' if s.bytes else ''}" for i, s in enumerate(self.steps, 1)]
        total = f"{self.bytes} bytes to load, about {self.seconds * 1000:.1f} ms" if steps else "nothing to do"
        return "\n".join([*steps, f"{place(self.config_name, self.mode)}: {total}"])

    def _repr_html_(self) -> str:
        from cm.wire.messages import notebook

        return notebook.plan(self)


@dataclass(frozen=True, slots=True)
class ChangeInfo:
    """A change that was accepted (`done` False) or has ended well (`done` True)."""

    number: int
    done: bool
    seconds: float = 0.0
    generation: int = 0  # of the registers when it ended


@dataclass(frozen=True, slots=True)
class LeaseInfo:
    """A lease that was granted."""

    id: str
    scope: str
    exclusive: bool
    seconds: float
    holder: str = ""


@dataclass(frozen=True, slots=True)
class UploadInfo:
    """How many bytes of an upload of `length` have come."""

    id: str
    length: int
    got: int


@dataclass(frozen=True, slots=True)
class FrameInfo:
    """What accompanies a payload of stream data.

    Times are CLOCK_MONOTONIC of the manager's machine. For a payload from a memory `stream` is the memory's name, and
    `offset` where in it the payload begins.
    """

    stream: str
    sequence: int
    timestamp_ns: int
    length: int
    shape: tuple[int, ...] = ()
    dtype: str = "uint8"
    config_name: str = ""
    mode: str = ""
    offset: int = 0
    generation: int = 0  # of the registers, when the frame began; 0: not known
    format: str = ""  # of the payload's pixels, as in the runtime schema; empty: shape and dtype say all
    failed: int = 0  # of the `lost`, those whose transfer failed; in a message: of all since the stream was opened
    lost: int = 0  # frames between the reader's last one and this: they failed, or came while it was too slow


@dataclass(frozen=True, slots=True)
class Irq:
    """An interrupt that came: its count since the configuration was loaded, and when."""

    name: str
    count: int
    timestamp_ns: int


@dataclass(frozen=True, slots=True)
class Audit:
    """A request that may change something, who made it, and how it ended.

    `message` is that of the topic, without ids of leases. Times are CLOCK_MONOTONIC; `ended_ns` is 0 while the request
    is under way. `generation` is that of the registers that it wrote, `change` the number of the change that it was.
    """

    request: str
    topic: str
    message: bytes
    client: str
    account: str
    pid: int
    began_ns: int
    ended_ns: int = 0
    error: ErrorInfo | None = None
    generation: int = 0
    change: int = 0


Body = (
    Status
    | ConfigInfo
    | RegValues
    | StreamStatus
    | FrameInfo
    | UploadInfo
    | PlanInfo
    | LeaseInfo
    | ChangeInfo
    | Irq
    | MemoryInfo
    | RegionCheck
    | RegionMap
    | None
)


class Reply(NamedTuple):
    """An answer: a body, or an error; `sequence` is the status's at that time.

    `encoded`: in place of a body, its bytes as they stand in the message.
    """

    body: Body = None
    error: ErrorInfo | None = None
    sequence: int = 0
    payload: tuple[bytes | memoryview, ...] = ()
    encoded: bytes = b""

# SPDX-License-Identifier: Apache-2.0
"""What a record holds: the contract between those who write records and those who read them.

**Files.** A record is one MCAP file, or several that follow each other: `files_of` gives them in order. It has MCAP's
profile "" and no compression. Chunks have CRCs, and each is whole on disk about a second after its last message. A file
whose recorder was killed has no summary, nor has one whose disk had no room for that: read it from the front
(``NonSeekingReader(f, validate_crcs=True)``), until an error says that its end is missing.

**Time.** `log_time` and `publish_time` of a message are the *time of the record*: CLOCK_MONOTONIC of the manager's
machine at the event, plus `Opened.offset_ns`, which is what CLOCK_REALTIME was ahead of it when recording began. So it
is wall time that no setting of a clock breaks; where the clock was set later, `CLOCK` tells both clocks each second,
and `Status.realtime_offset_ns` the difference. A time in a message (`…_ns`) is CLOCK_MONOTONIC: `time_of` makes the
record's of it. Events that have a time of their own (`cm_irq`, frames, `cm_audit`) have that, others that at which they
reached the recorder; so messages are nearly, but not quite, in the order of their times.

**Topics.** All are protobuf (encoding and schema), messages of `cm.proto` but for pictures.

| topic | message | what |
|---|---|---|
| `cm_status` | cm.Status | as published: steps of a change (`progress`), leases, streams, upsets, last_error |
| `cm_read_config` | cm.Config | the loaded configuration, its runtime schema's text, when it or the mode is another |
| `cm_read_reg` | cm.RegValues | written: as published, with their `generation`; read by the recorder: generation 0 |
| `cm_irq` | cm.Irq | as published |
| `cm_audit` | cm.Audit | who asked for what, and how it ended; the write of `generation` N is that of its RegValues |
| `cm_frame/NAME` | cm.FrameSeen | each frame that the recorder received, also where its data are not kept |
| `cm_stream/NAME` | foxglove.RawImage | the data of a frame that Foxglove knows as a picture, as they came |
| `cm_stream/NAME` | cm.FrameData | the data of any other; the stream's topic then has another channel |
| `cm_clock` | cm.Clock | once a second |
| `cm_gap` | cm.Gap | what is missing, and why |

Every file begins with the state of then: Status, Config, RegValues (generation 0), Clock. So it can be read alone.
While the manager is gone there are clocks only, then a gap with cause manager_gone, then the state again.

**Metadata.** One record named `METADATA` at the beginning of each file: `Opened` as strings.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from cm.errors import InvalidRequest
from cm.frozen import dataclass
from cm.wire import topics

VERSION = "1"
METADATA = "cm.record"
STATUS, CONFIG, REGISTERS = topics.STATUS.decode(), topics.READ_CONFIG.decode(), topics.READ_REG.decode()
IRQ, AUDIT = topics.IRQ.decode(), topics.AUDIT.decode()
CLOCK, GAP = "cm_clock", "cm_gap"
FRAME_PREFIX, STREAM_PREFIX = "cm_frame/", topics.STREAM_PREFIX.decode()
SCHEMAS = {STATUS: "Status", CONFIG: "Config", REGISTERS: "RegValues", IRQ: "Irq", AUDIT: "Audit", CLOCK: "Clock",
           GAP: "Gap"}  # fmt: skip
FRAME, DATA = "FrameSeen", "FrameData"  # messages of the topics that a stream has


@dataclass(frozen=True, slots=True)
class Opened:
    """What the metadata of a file say.

    `number` counts the files of a record from 1; `started_ns` is the time of the record at which the first of them
    began. `manager` is the version of the manager, `manager_started_ns` its `Status.started_ns`.
    """

    board: str
    number: int
    started_ns: int
    offset_ns: int
    manager: str
    manager_started_ns: int
    recorder: str
    version: str = VERSION

    def time_of(self, monotonic_ns: int) -> int:
        """CLOCK_MONOTONIC of the manager's machine → time of the record."""
        return monotonic_ns + self.offset_ns

    def strings(self) -> dict[str, str]:
        """As metadata hold it."""
        return {name: str(getattr(self, name)) for name in self.__dataclass_fields__}


def opened(strings: Mapping[str, str]) -> Opened:
    """The metadata of a file. Raises InvalidRequest for those of another version, or of no record of ours."""
    if strings.get("version") != VERSION:
        raise InvalidRequest(f"its layout is {strings.get('version')!r}; this program knows version {VERSION}")
    try:
        numbers = [int(strings[name]) for name in ("number", "started_ns", "offset_ns", "manager_started_ns")]
        number, started, offset, manager = numbers
        return Opened(strings["board"], number, started, offset, strings["manager"], manager, strings["recorder"])
    except (KeyError, ValueError) as error:
        raise InvalidRequest(f"its metadata {METADATA!r} are not whole: {error}") from None


def is_folder(record: Path) -> bool:
    """Whether a record is a folder of files, by its name: one that does not end in ``.mcap``."""
    return record.suffix != ".mcap"


def file_name(record: Path, number: int) -> Path:
    """The place of a record's file: ``FILE.mcap``, then ``FILE-000002.mcap`` beside it; ``FOLDER/000001.mcap``."""
    if is_folder(record):
        return record / f"{number:06d}.mcap"
    return record if number == 1 else record.with_name(f"{record.stem}-{number:06d}{record.suffix}")


def files_of(record: Path) -> list[Path]:
    """The files of a record, in order: of a file and its successors, or all of a folder. Raises InvalidRequest."""
    if record.is_dir():
        found = sorted(record.glob("*.mcap"))
    else:
        later = re.compile(re.escape(record.stem) + r"-\d{6}" + re.escape(record.suffix))
        beside = record.parent.iterdir() if record.parent.is_dir() else ()
        found = [*([record] if record.exists() else []), *sorted(p for p in beside if later.fullmatch(p.name))]
    if not found:
        raise InvalidRequest(f"{record}: there is no record")
    return found

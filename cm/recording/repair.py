# SPDX-License-Identifier: Apache-2.0
"""What is whole of a damaged record, as a file that every reader takes. Nothing that was damaged is in it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

from mcap.records import Channel, Header, Metadata, Schema
from mcap.writer import CompressionType, Writer

from cm.errors import InvalidRequest
from cm.frozen import dataclass
from cm.recording.layout import GAP, METADATA, SCHEMAS
from cm.recording.salvage import Described, described
from cm.wire.encode import encoded
from cm.wire.records import Gap, descriptor_set


@dataclass(frozen=True, slots=True)
class Repaired:
    """How many messages were whole, and a sentence on each thing that was not; `orphans`: whole, but of no channel."""

    messages: int
    orphans: int
    lost: tuple[str, ...]


def repair(source: Path, target: Path) -> Repaired:
    """Write what is whole of a file to another, which is not there yet. Raises InvalidRequest, OSError."""
    if target.exists():
        raise InvalidRequest(f"{target} is there already: name another file, or remove it")
    beside = target.with_name(f".{target.name}.part")
    try:
        with beside.open("wb") as stream:
            found = _Copy(source, stream).run()
        beside.rename(target)
    except OSError as error:
        if error.filename in (None, str(beside)):  # nobody has named that one; a full disk names none
            error.filename, error.filename2 = str(target), None
        raise
    finally:
        with suppress(OSError):
            beside.unlink()
    return found


class _Copy:
    """One file on its way into another."""

    def __init__(self, source: Path, stream: Any) -> None:
        self._source = source
        # No summary offsets: it writes those of empty groups too, which pymcap-cli's doctor calls an error.
        self._writer = Writer(stream, compression=CompressionType.NONE, use_summary_offsets=False)
        self._began = False
        self._ours = False
        self._made: dict[int, int] = {}  # channels of the source → those of the copy
        self._made_schemas: dict[int, int] = {0: 0}
        self._gaps = 0  # the channel of gaps, once there is one
        self._lost: list[str] = []
        self._told = 0
        self._messages = self._orphans = self._last = 0

    def run(self) -> Repaired:
        for record in described(self._source, self._lost.append):
            self._tell()
            self._take(record)
        self._tell()
        if not self._began:
            raise InvalidRequest(f"{self._source}: nothing of it is whole ({'; '.join(self._lost)})")
        self._writer.finish()
        return Repaired(self._messages, self._orphans, tuple(self._lost))

    def _take(self, record: Any) -> None:
        if not self._began:
            self._began = True
            self._writer.start(record.profile if isinstance(record, Header) else "")
        if isinstance(record, Metadata):
            self._ours = self._ours or record.name == METADATA
            self._writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Described):
            self._copy(record)

    def _copy(self, found: Described) -> None:
        message, channel = found.message, found.channel
        if channel is None:
            self._orphans += 1
            return
        self._last = max(self._last, message.log_time)
        self._messages += 1
        number = self._made.get(channel.id) or self._channel(channel, found.schema)
        self._writer.add_message(number, message.log_time, message.data, message.publish_time, message.sequence)

    def _channel(self, channel: Channel, described: Schema | None) -> int:
        schema = self._made_schemas.get(channel.schema_id)
        if schema is None:
            assert described is not None
            schema = self._writer.register_schema(described.name, described.encoding, described.data)
            self._made_schemas[described.id] = schema
        made = self._writer.register_channel(channel.topic, channel.message_encoding, schema, channel.metadata)
        self._made[channel.id] = made
        return made

    def _tell(self) -> None:
        """A record of ours says of itself where something is missing."""
        for text in self._lost[self._told :] if self._ours else ():
            if not self._gaps:
                schema = self._writer.register_schema(f"cm.{SCHEMAS[GAP]}", "protobuf", descriptor_set())
                self._gaps = self._writer.register_channel(GAP, "protobuf", schema)
            gap = encoded(Gap("", self._last, self._last, cause="damaged", text=text))
            self._writer.add_message(self._gaps, self._last, gap, self._last)
        if self._ours:
            self._told = len(self._lost)

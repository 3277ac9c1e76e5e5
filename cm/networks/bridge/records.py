# SPDX-License-Identifier: Apache-2.0
"""What a bridge has to tell, as frozen data, and what the frames of each stream are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.errors import CmError
from cm.schema import loads
from cm.schema.model import Stream
from cm.schema.pictures import CameraInfo, implied_encoding, misfit
from cm.wire.messages.status import ConfigInfo, FrameInfo, RegisterInfo, Status, StreamStatus


@dataclass(frozen=True, slots=True)
class Caller:
    """In whose name a request is made: the policy's `guest` (empty: the bridge itself), and its leases' ids."""

    guest: str = ""
    lease: str = ""


@dataclass(frozen=True, slots=True)
class StreamFormat:
    """A stream in the mode that runs, and what its frames are. `encoding` is empty if they are not pictures."""

    name: str
    writes: bool  # towards the hardware
    shape: tuple[int, ...]
    dtype: str
    encoding: str
    frame_id: str
    camera_info: CameraInfo | None = None


@dataclass(frozen=True, slots=True)
class ConfigRecord:
    """The configuration and mode that run, and what can be named in them; empty while nothing is loaded."""

    stamp_ns: int
    config: ConfigInfo
    streams: tuple[StreamFormat, ...] = ()

    @property
    def registers(self) -> tuple[RegisterInfo, ...]:
        """The registers that the mode has."""
        mode = self.config.mode
        return tuple(r for r in self.config.registers if not r.modes or mode in r.modes)

    def stream(self, name: str) -> StreamFormat | None:
        """The stream of that name, if the mode has one."""
        return next((stream for stream in self.streams if stream.name == name), None)


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame in place: `data` is read-only memory of the manager, valid until the call that passes it returns.

    `height`, `width` and `step` (bytes from row to row) are 0 if `encoding` is empty.
    """

    stream: str
    stamp_ns: int
    sequence: int
    frame_id: str
    encoding: str
    height: int
    width: int
    step: int
    data: npt.NDArray[Any]


def config_record(status: Status, config: ConfigInfo, stamp_ns: int) -> ConfigRecord:
    """What runs, from the status and the description of the loaded configuration (empty: nothing is loaded)."""
    said = _said(status, config)
    streams = tuple(stream_format(stream, said.get(stream.name)) for stream in status.streams)
    return ConfigRecord(stamp_ns, config, streams)


def _said(status: Status, config: ConfigInfo) -> Mapping[str, Stream]:
    """The streams as the schema has them in this mode; none if this version cannot read it."""
    if not config.schema:
        return {}
    try:
        held = {region.name: region.module for region in status.regions}
        return loads(config.schema).streams_in(status.mode, held)
    except CmError:  # a newer manager's schema may have keys that this version does not know
        return {}


_ENCODINGS = {"bgr": "bgr8", "rbg": "8UC3", "yuv422": "yuv422_yuy2"}  # ROS's names of pixels in memory


def stream_format(now: StreamStatus, said: Stream | None) -> StreamFormat:
    """A stream as it is set now, with what the schema says of its frames."""
    frame_id = said.frame_id if said is not None and said.frame_id else now.name
    writes = now.direction == "mm2s"
    shape = (*now.shape[:2], 3) if now.format and not writes else now.shape  # what is read of pixels is RGB
    named = _ENCODINGS.get(now.format) if writes else None  # what is written goes as it is
    return StreamFormat(
        name=now.name,
        writes=writes,
        shape=shape,
        dtype=now.dtype,
        encoding=encoding_of(shape, now.dtype, named or (said.encoding if said is not None else None)),
        frame_id=frame_id,
        camera_info=said.camera_info if said is not None else None,
    )


def encoding_of(shape: tuple[int, ...], dtype: str, said: str | None) -> str:
    """The encoding of frames: the declared one if it fits, else what shape and dtype imply; empty: no pictures."""
    if said and not misfit(said, shape, np.dtype(dtype).itemsize):
        return said
    return implied_encoding(shape, dtype)


def frame_record(stream: StreamFormat, array: npt.NDArray[Any], info: FrameInfo, offset: int) -> FrameRecord:
    """A frame with what is known of it. `offset`: wall time less the board's CLOCK_MONOTONIC, nanoseconds."""
    plain = array.view(np.ndarray)
    encoding = encoding_of(info.shape, info.dtype, stream.encoding)
    rows, columns = info.shape[:2] if encoding else (0, 0)
    return FrameRecord(
        stream=info.stream,
        stamp_ns=info.timestamp_ns + offset,
        sequence=info.sequence,
        frame_id=stream.frame_id,
        encoding=encoding,
        height=rows,
        width=columns,
        step=int(plain.nbytes) // rows if encoding else 0,
        data=plain,
    )

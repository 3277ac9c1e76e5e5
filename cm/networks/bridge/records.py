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
from cm.wire.messages.status import (
    ConfigInfo,
    FrameInfo,
    InterruptInfo,
    Irq,
    ModeInfo,
    RegisterInfo,
    RegValues,
    Status,
    StreamStatus,
)


@dataclass(frozen=True, slots=True)
class Identity:
    """Which board it is, and which run of its manager: `started_ns` changes with each restart."""

    name: str
    version: str = ""
    started_ns: int = 0


@dataclass(frozen=True, slots=True)
class Caller:
    """In whose name a request is made: the policy's `guest` (empty: the bridge itself), and its leases' ids."""

    guest: str = ""
    lease: str = ""


@dataclass(frozen=True, slots=True)
class StatusRecord:
    """A status, whole."""

    board: Identity
    stamp_ns: int
    status: Status


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
    rate: float = 0.0  # frames per second that the source gives; 0: not known


@dataclass(frozen=True, slots=True)
class ConfigRecord:
    """The configuration and mode that run, and what can be named in them; empty while nothing is loaded."""

    board: Identity
    stamp_ns: int
    config: ConfigInfo
    configs: tuple[str, ...]  # that can be loaded
    streams: tuple[StreamFormat, ...] = ()

    @property
    def modes(self) -> tuple[ModeInfo, ...]:
        """All modes of the configuration."""
        return self.config.modes

    @property
    def registers(self) -> tuple[RegisterInfo, ...]:
        """The registers that the mode has."""
        mode = self.config.mode
        return tuple(r for r in self.config.registers if not r.modes or mode in r.modes)

    @property
    def interrupts(self) -> tuple[InterruptInfo, ...]:
        """The interrupts of the configuration."""
        return self.config.interrupts

    def stream(self, name: str) -> StreamFormat | None:
        """The stream of that name, if the mode has one."""
        return next((stream for stream in self.streams if stream.name == name), None)


@dataclass(frozen=True, slots=True)
class RegistersRecord:
    """Registers that any client wrote, with their new values; the stamp is when the bridge learned of it."""

    board: Identity
    stamp_ns: int
    registers: RegValues


@dataclass(frozen=True, slots=True)
class InterruptRecord:
    """An interrupt that came."""

    board: Identity
    stamp_ns: int
    irq: Irq


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """A frame in place: `data` is read-only memory of the manager, valid until the call that passes it returns.

    `height`, `width` and `step` (bytes from row to row) are 0 if `encoding` is empty.
    """

    board: str
    stream: str
    stamp_ns: int
    sequence: int
    frame_id: str
    encoding: str
    height: int
    width: int
    step: int
    data: npt.NDArray[Any]
    mode: str = ""
    generation: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""
        return tuple(int(length) for length in self.data.shape)

    @property
    def dtype(self) -> str:
        """Of the elements, a numpy name."""
        return str(np.dtype(self.data.dtype).name)


def identity(status: Status) -> Identity:
    """Which board a status is of."""
    return Identity(status.board, status.version, status.started_ns)


def config_record(status: Status, config: ConfigInfo, stamp_ns: int) -> ConfigRecord:
    """What runs, from the status and the description of the loaded configuration (empty: nothing is loaded)."""
    said = _said(status, config)
    streams = tuple(stream_format(stream, said.get(stream.name)) for stream in status.streams)
    return ConfigRecord(identity(status), stamp_ns, config, status.configs, streams)


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
        rate=(said.rate or 0.0) if said is not None else 0.0,
    )


def encoding_of(shape: tuple[int, ...], dtype: str, said: str | None) -> str:
    """The encoding of frames: the declared one if it fits, else what shape and dtype imply; empty: no pictures."""
    if said and not misfit(said, shape, np.dtype(dtype).itemsize):
        return said
    return implied_encoding(shape, dtype)


def frame_record(
    board: str, stream: StreamFormat, array: npt.NDArray[Any], info: FrameInfo, offset: int
) -> FrameRecord:
    """A frame with what is known of it. `offset`: wall time less the board's CLOCK_MONOTONIC, nanoseconds."""
    plain = array.view(np.ndarray)
    encoding = encoding_of(info.shape, info.dtype, stream.encoding)
    rows, columns = info.shape[:2] if encoding else (0, 0)
    return FrameRecord(
        board=board,
        stream=info.stream,
        stamp_ns=info.timestamp_ns + offset,
        sequence=info.sequence,
        frame_id=stream.frame_id,
        encoding=encoding,
        height=rows,
        width=columns,
        step=int(plain.nbytes) // rows if encoding else 0,
        data=plain,
        mode=info.mode,
        generation=info.generation,
    )

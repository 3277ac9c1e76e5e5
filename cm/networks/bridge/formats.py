# SPDX-License-Identifier: Apache-2.0
"""What the frames of each stream are, by the schema; settings at run time and the frames themselves may differ."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.errors import CmError
from cm.networks.bridge.records import ConfigRecord, FrameRecord, Identity, StreamFormat
from cm.schema import loads
from cm.schema.model import Stream
from cm.schema.pictures import implied_encoding, misfit
from cm.wire.messages.status import ConfigInfo, FrameInfo, Status, StreamStatus


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


def stream_format(now: StreamStatus, said: Stream | None) -> StreamFormat:
    """A stream as it is set now, with what the schema says of its frames."""
    frame_id = said.frame_id if said is not None and said.frame_id else now.name
    return StreamFormat(
        name=now.name,
        writes=now.direction == "mm2s",
        shape=now.shape,
        dtype=now.dtype,
        encoding=encoding_of(now.shape, now.dtype, said.encoding if said is not None else None),
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

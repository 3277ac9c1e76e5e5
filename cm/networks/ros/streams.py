# SPDX-License-Identifier: Apache-2.0
"""The node's topics of frames: each stream of the mode that runs, read while it has subscribers."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from cm.client.board import Board
from cm.errors import CmError, InvalidRequest
from cm.networks.bridge.commands import Commands
from cm.networks.bridge.records import Caller, ConfigRecord, FrameRecord, StreamFormat
from cm.networks.bridge.streams import FrameReader, FrameWriter
from cm.networks.ros import messages
from cm.networks.ros.transport import Body, Closing, Publisher, Qos, Transport
from cm.schema.pictures import misfit

_LOG = logging.getLogger("cm.ros")


class ReadableStream:
    """``NAME/image_raw`` and ``NAME/camera_info`` of pictures, ``NAME/data`` of others."""

    def __init__(self, transport: Transport, base: str, stream: StreamFormat, board: Board, frames: Qos) -> None:
        self._stream = stream
        self._publisher: Publisher
        self._info: Publisher | None = None
        if stream.encoding:
            self._publisher = transport.publisher(f"{base}/image_raw", "sensor_msgs/msg/Image", frames)
            self._info = transport.publisher(f"{base}/camera_info", "sensor_msgs/msg/CameraInfo", frames)
        else:
            self._publisher = transport.publisher(f"{base}/data", "cm_interfaces/msg/Data", frames)
        self._reader = FrameReader(board, stream, self._take)

    def look(self) -> None:
        """Run only while there are subscribers."""
        info = self._info.listeners() if self._info is not None else 0
        if self._publisher.listeners() + info:
            self._reader.start()
        else:
            self._reader.stop()

    def _take(self, frame: FrameRecord) -> None:
        if self._info is None:
            self._publisher.write_frame(messages.data_head(frame), frame)
        elif frame.encoding:  # a packet that was cut short has no rows
            self._publisher.write_frame(messages.image_head(frame), frame)
            self._info.write(messages.camera_info(self._stream, frame))

    def close(self) -> None:
        self._reader.stop()
        self._publisher.close()
        if self._info is not None:
            self._info.close()


class WritableStream:
    """``NAME/write``, images for a stream of pictures; ``NAME/write_data`` for others."""

    def __init__(
        self, transport: Transport, base: str, stream: StreamFormat, commands: Commands, caller: Caller, frames: Qos
    ) -> None:
        self._stream = stream
        self._commands = commands
        self._caller = caller
        self._writer: FrameWriter | None = None
        self._told = ""
        kind, topic = (
            ("sensor_msgs/msg/Image", "write") if stream.encoding else ("cm_interfaces/msg/Data", "write_data")
        )
        self._subscription: Closing = transport.frames(f"{base}/{topic}", kind, frames, self._take)

    def look(self) -> None:
        """Does nothing: work is done only when a frame comes."""

    def _take(self, values: Mapping[str, Any], body: Body) -> None:
        try:
            if self._writer is None:
                self._writer = self._commands.writer(self._caller, self._stream.name)
            if self._rows_follow_each_other(values, body.length):
                self._writer.fill(body.length, body.into)
            else:
                self._writer.write(self._rows(values, body))
        except (CmError, OSError) as error:
            self._tell(str(error))
            self._drop()
        else:
            self._told = ""

    def _tell(self, problem: str) -> None:
        """Log a problem once for all frames that have it."""
        if problem != self._told:
            self._told = problem
            _LOG.warning("frames for %s are not written: %s", self._stream.name, problem)

    def _rows_follow_each_other(self, values: Mapping[str, Any], length: int) -> bool:
        """Raises InvalidRequest for what is not a picture of this stream."""
        if not self._stream.encoding:
            return True
        if values["encoding"] != self._stream.encoding:
            raise InvalidRequest(f"it is {values['encoding']}; the stream takes {self._stream.encoding}")
        height, step = values["height"], values["step"]
        if not height or length < height * step or (step and self._row(values) > step):
            raise InvalidRequest(f"{length} bytes are not {height} rows of {step} bytes")
        return not step or (self._row(values) == step and length == height * step)

    def _rows(self, values: Mapping[str, Any], body: Body) -> npt.NDArray[np.uint8]:
        """The rows without the padding between them."""
        data = np.empty(body.length, np.uint8)
        body.into(data)
        height, step = values["height"], values["step"]
        return data[: height * step].reshape(height, step)[:, : self._row(values)]

    def _row(self, values: Mapping[str, Any]) -> int:
        shape = self._stream.shape
        item = np.dtype(self._stream.dtype).itemsize
        assert not misfit(self._stream.encoding, shape, item)
        return int(values["width"] * item * int(np.prod(shape[2:], dtype=int)))

    def _drop(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def close(self) -> None:
        self._subscription.close()
        self._drop()


class Streams:
    """Those of the mode that runs."""

    def __init__(self, transport: Transport, base: str, commands: Commands, caller: Caller, frames: Qos) -> None:
        self._transport = transport
        self._base = base
        self._commands = commands
        self._caller = caller
        self._frames = frames
        self._open: dict[str, tuple[Any, ReadableStream | WritableStream]] = {}

    def take(self, record: ConfigRecord, board: Board) -> None:
        """Open new topics and close old ones; those that have not changed continue."""
        may = "frames" in self._commands.writes
        wanted = {s.name: s for s in record.streams if not s.writes or (may and s.shape)}
        for name in [name for name, (kept, _) in self._open.items() if kept != _kind(wanted.get(name))]:
            self._open.pop(name)[1].close()
        for name, stream in wanted.items():
            if name not in self._open:
                self._open[name] = (_kind(stream), self._made(stream, board))

    def _made(self, stream: StreamFormat, board: Board) -> ReadableStream | WritableStream:
        base = f"{self._base}/{stream.name.replace('-', '_')}"
        if stream.writes:
            return WritableStream(self._transport, base, stream, self._commands, self._caller, self._frames)
        return ReadableStream(self._transport, base, stream, board, self._frames)

    def look(self) -> None:
        for _, stream in tuple(self._open.values()):
            stream.look()

    def close(self) -> None:
        while self._open:
            self._open.popitem()[1][1].close()


def _kind(stream: StreamFormat | None) -> Any:
    """If this differs, another endpoint is needed; the shape of frames that are read may change without one."""
    if stream is None:
        return None
    if stream.writes:
        return stream
    return stream.writes, bool(stream.encoding), stream.frame_id, stream.camera_info

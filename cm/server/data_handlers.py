# SPDX-License-Identifier: Apache-2.0
"""Handlers of requests for streams and memories, which share one name space; long transfers go piece by piece."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from cm.errors import CmError, InvalidRequest
from cm.manager.access.memory_service import MemoryService, Transfer
from cm.manager.errors import UnknownStream
from cm.manager.manager import Manager
from cm.schema.model import Stream
from cm.server.board_watch import BoardWatch
from cm.server.replies import Respond, error_info, refusal
from cm.server.shares import Client
from cm.server.steps import Done, Steps
from cm.server.streams.running import Streams
from cm.server.streams.stream import Frame
from cm.wire.messages import requests as rq
from cm.wire.messages.status import PIXEL_FORMAT, ConfigInfo, FrameInfo, Reply, StreamStatus


class OtherPixels(InvalidRequest):
    """A picture for a stream whose pixels lie in another order in memory."""

    code = PIXEL_FORMAT


class MemoryTransfers:
    """Transfers of a client one after the other, clients by turns. Everything in the loop's thread."""

    def __init__(self, steps: Steps, memories: MemoryService) -> None:
        self._steps = steps
        self._memories = memories

    def described(self, info: ConfigInfo) -> ConfigInfo:
        """A configuration with the memories that were defined for it, if it is the loaded one."""
        blocks = self._memories.defined() if info.mode else ()
        return replace(info, memories=(*info.memories, *blocks)) if blocks else info

    def start(self, client: Client, transfer: Transfer, done: Done) -> None:
        """Begin a transfer, a read when its client has room for the answer.

        `done` is called once, now or later, with the error, if any. Raises Busy.
        """
        if transfer.write:
            self._steps.start(client, transfer, done)
            return
        reserved = 0

        def may_begin() -> bool:
            nonlocal reserved
            if client.has_room(transfer.length):
                reserved = transfer.length
                client.make(reserved)
            return reserved > 0

        def ended(problem: Exception | None) -> None:
            client.make(-reserved)
            done(problem)

        self._steps.start(client, transfer, ended, may_begin)


def frame_info(transfer: Transfer, config: str, mode: str) -> FrameInfo:
    """What accompanies the payload of a memory."""
    shape, dtype = transfer.form
    memory, length = transfer.memory, transfer.length
    return FrameInfo(memory.name, 0, time.monotonic_ns(), length, shape, dtype, config, mode, offset=transfer.offset)


class DataHandlers:
    """As `cm.server.handlers.Handlers`, which has them in its table."""

    def __init__(self, manager: Manager, streams: Streams, transfers: MemoryTransfers, board: BoardWatch) -> None:
        self._manager = manager
        self._memories = manager.memories
        self._streams = streams
        self._transfers = transfers
        self._board = board

    @property
    def table(self) -> Mapping[type, Callable[..., None]]:
        """The handler of each kind of request."""
        return {
            rq.DescribeData: self._describe_data,
            rq.ConfigureStream: self._configure_stream,
            rq.DefineMemory: self._define_memory,
            rq.ReadData: self._read_data,
            rq.WriteData: self._write_data,
        }

    def _describe_data(self, request: rq.DescribeData, respond: Respond) -> None:
        memory = self._memories.find(request.name)
        if memory is not None:
            respond(Reply(self._memories.info(memory)))
            return
        stream = self._stream(request.name)
        self._streams.check_lease(stream, request.lease)
        respond(Reply(self._streams.status_of(stream.name)))

    def _configure_stream(self, request: rq.ConfigureStream, respond: Respond) -> None:
        self._memories.check_no_memory(request.stream)
        self._streams.check_lease(self._stream(request.stream), request.lease)
        self._streams.configure(request, partial(self._told, respond))

    def _told(self, respond: Respond, result: StreamStatus | FrameInfo | Exception) -> None:
        if isinstance(result, Exception):
            self._board.noticed(result)
            respond(Reply(error=error_info(result)))
        else:
            respond(Reply(result))

    def _define_memory(self, request: rq.DefineMemory, respond: Respond) -> None:
        respond(Reply(self._memories.info(self._memories.define(request))))

    def _stream(self, name: str) -> Stream:
        """A stream by name. Raises UnknownStream, which names the memories too: one of them may have been meant."""
        try:
            return self._streams.named(name, None)
        except UnknownStream as error:
            raise UnknownStream(f"{error}{self._memories.listed()}") from None

    def _read_data(self, request: rq.ReadData, respond: Respond, client: Client) -> None:
        if request.offset or request.length or self._memories.find(request.stream):
            self._transfer(client, self._memories.begin_read(request.stream, request.offset, request.length), respond)
            return
        if request.stream:
            self._stream(request.stream)
        client.check_room()

        def done(result: Frame | CmError | OSError) -> None:
            if isinstance(result, Frame):
                respond(Reply(result.info, payload=(result.data,)))
            else:
                self._told(respond, result)

        self._streams.read_once(request.stream, request.timeout, done)

    def _write_data(self, request: rq.WriteData, respond: Respond, client: Client) -> None:
        if request.offset or self._memories.find(request.stream):
            written = self._memories.begin_write(request.stream, request.offset, request.data, request.lease)
            self._transfer(client, written, respond)
            return
        if request.stream:
            stream = self._stream(request.stream)
            if request.format and stream.format and request.format != stream.format:
                raise OtherPixels(f"stream {stream.name!r} takes pixels of {stream.format}, not {request.format}")

        def done(result: Frame | CmError | OSError) -> None:
            self._told(respond, result.info if isinstance(result, Frame) else result)

        self._streams.write(request.stream, request.data, done, request.lease)

    def _transfer(self, client: Client, transfer: Transfer, respond: Respond) -> None:
        def done(problem: Exception | None) -> None:
            if problem is None:
                respond(self._moved(transfer))
            else:
                self._board.noticed(problem)
                respond(refusal(problem))

        self._transfers.start(client, transfer, done)

    def _moved(self, transfer: Transfer) -> Reply:
        state, payload = self._manager.state, () if transfer.write else (transfer.data,)
        return Reply(frame_info(transfer, state.config or "", state.mode or ""), payload=payload)

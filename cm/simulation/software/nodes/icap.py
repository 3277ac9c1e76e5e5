# SPDX-License-Identifier: Apache-2.0
"""ICAP as a node: the requests of ``cm_icap.h``."""

from __future__ import annotations

import errno
import time
from collections.abc import Sequence

from cm.simulation.software.errors import NodeError
from cm.simulation.software.faults import Faults
from cm.simulation.software.hardware.configuration_engine import ConfigurationEngine, LoadResult, Through
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.buffers import Buffer, Buffers, BufferSession, DmaMemory, Syncs, fit
from cm.simulation.software.transport.session import Events

MAX_LENGTH = 1 << 26
_FLAGS = protocol.LOAD_FULL | protocol.LOAD_ENCRYPTED


class IcapNode:
    """``/dev/cm_icap0``; any number of files may be open."""

    def __init__(
        self, engine: ConfigurationEngine, through: Through, memory: DmaMemory, idcode: int, clock_hz: int,
        faults: Faults,
    ) -> None:  # fmt: skip
        self.engine, self.through, self._memory, self._faults = engine, through, memory, faults
        self.idcode, self.clock_hz = idcode, clock_hz
        self.sessions: set[IcapSession] = set()
        self.syncs = Syncs()

    @property
    def readable(self) -> bool:
        """Whether the port has a way back."""
        return self._faults.take("icap_write_only") is None

    def open(self, events: Events) -> IcapSession:
        """A new open file."""
        session = IcapSession(self, Buffers(self._memory, self.syncs), events)
        self.sessions.add(session)
        return session


class IcapSession(BufferSession):
    """One open file; it sees the completions of its own loads only."""

    def __init__(self, node: IcapNode, buffers: Buffers, events: Events) -> None:
        self._node = node
        self._events: Events | None = events
        super().__init__(
            buffers,
            protocol.ICAP_IOC_INFO,
            {
                protocol.ICAP_IOC_INFO: self._info,
                protocol.ICAP_IOC_LOAD: self._load,
                protocol.ICAP_IOC_READ: self._read,
                protocol.ICAP_IOC_STATUS: self._status,
            },
        )

    def close(self) -> None:
        """The file was closed; a load that runs continues to its end, without being reported."""
        self._events = None
        self.buffers.close()
        self._node.sessions.discard(self)

    def _info(self, payload: bytes) -> bytes:
        protocol.require_zero(protocol.unpack(protocol.ICAP_INFO, payload)[0])
        node = self._node
        caps = protocol.ICAP_CAP_STATUS | (protocol.ICAP_CAP_READ if node.readable else 0)
        info = protocol.ICAP_INFO.pack(len(payload), 0, 32, node.clock_hz, MAX_LENGTH, node.idcode, caps)
        return fit(info, payload)

    def _load(self, payload: bytes) -> bytes:
        asked_ns = time.monotonic_ns()
        flags, handle, reserved, offset, length, cookie = protocol.unpack(protocol.ICAP_LOAD, payload)
        protocol.require_zero(flags & ~_FLAGS, reserved)
        buffer = self.buffers.get(handle)
        if offset % 4 or length % 4 or length <= 0 or offset + length > buffer.length:
            raise NodeError(errno.EINVAL, "the range is empty, not of whole words or not inside the buffer")
        if length > MAX_LENGTH:
            raise NodeError(errno.EMSGSIZE, f"a load has at most {MAX_LENGTH} bytes")
        if flags & protocol.LOAD_ENCRYPTED:
            raise NodeError(errno.EOPNOTSUPP, "the simulated device has no key")
        data = buffer.memory[offset : offset + length]
        full = bool(flags & protocol.LOAD_FULL)
        node = self._node
        node.engine.start(
            data, lambda result: self._finished(buffer, cookie, result), full, asked_ns=asked_ns, through=node.through
        )
        buffer.inflight += 1
        return payload

    def _read(self, payload: bytes) -> bytes:
        asked_ns = time.monotonic_ns()
        flags, handle, reserved, *places, cookie = protocol.unpack(protocol.ICAP_READ, payload)
        protocol.require_zero(flags, reserved)
        if not self._node.readable:
            raise NodeError(errno.EOPNOTSUPP, "the port has no way back")
        buffer = self.buffers.get(handle)
        request, reply, closing = self._parts(buffer, places)
        if not (buffer.allocated and buffer.writable):
            raise NodeError(errno.EINVAL, "what is read goes into memory that was allocated here")
        self._node.engine.read(request, reply, closing, lambda result: self._finished(buffer, cookie, result), asked_ns)
        buffer.inflight += 1
        return payload

    def _parts(self, buffer: Buffer, places: Sequence[int]) -> Sequence[memoryview]:
        """The parts of a read, whole words inside of the buffer, that do not overlap (EINVAL, EMSGSIZE)."""
        ranges = list(zip(places[::2], places[1::2], strict=True))
        end = 0
        for offset, length in sorted(ranges):
            if offset % 4 or length % 4 or length <= 0 or offset < end or offset + length > buffer.length:
                raise NodeError(errno.EINVAL, "a part is empty, not of whole words, not inside the buffer, or overlaps")
            end = offset + length
            if length > MAX_LENGTH:
                raise NodeError(errno.EMSGSIZE, f"each part has at most {MAX_LENGTH} bytes")
        return [buffer.memory[offset : offset + length] for offset, length in ranges]

    def _finished(self, buffer: Buffer, cookie: int, result: LoadResult) -> None:
        buffer.inflight -= 1
        if self._events is not None:
            self._events.send(
                protocol.ICAP_COMPLETION.pack(
                    cookie, result.length, result.started_ns, result.finished_ns, result.status, result.errors
                )
            )

    def _status(self, payload: bytes) -> bytes:
        protocol.require_zero(protocol.unpack(protocol.ICAP_STATUS, payload)[0])
        engine = self._node.engine
        status = protocol.ICAP_STATUS.pack(
            len(payload), 0, engine.state, engine.errors, engine.done, engine.total, engine.loads
        )
        return fit(status, payload)

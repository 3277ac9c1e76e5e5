# SPDX-License-Identifier: Apache-2.0
"""DMA channels as nodes: the requests of ``cm_dma.h``."""

from __future__ import annotations

import errno
from collections.abc import Callable

from cm.schema.model import Direction
from cm.simulation.software.errors import NodeError
from cm.simulation.software.hardware.board_spec import ChannelSpec
from cm.simulation.software.hardware.dma import MAX_LENGTH, MAX_LINE, QUEUE_DEPTH, Channel, Completions, Transfer
from cm.simulation.software.transport import protocol
from cm.simulation.software.transport.buffers import Buffer, Buffers, BufferSession, DmaMemory, Syncs, fit
from cm.simulation.software.transport.session import Events
from cm.wire.lazy_numpy import np

_CAPS = protocol.CAP_CYCLIC | protocol.CAP_VIDEO | protocol.CAP_RESIDUE
_VDMA_CAPS = protocol.CAP_VIDEO  # as the kernel's driver has it; frames of a VDMA are always whole
_ALIGNMENT = 1  # as an engine with the data realignment engine (PG021)


class DmaNode:
    """``/dev/cm_dma/<name>``, for one open file at a time."""

    def __init__(self, channel: Channel, memory: DmaMemory) -> None:
        self._channel, self._memory = channel, memory
        self.syncs = Syncs()
        self.sessions: set[DmaSession] = set()

    def open(self, events: Events) -> DmaSession:
        """Claim the channel."""
        buffers = Buffers(self._memory, self.syncs)
        self._channel.claim(Completions(events), buffers)
        session = DmaSession(self._channel, buffers, self.sessions.discard)
        self.sessions.add(session)
        return session


class DmaSession(BufferSession):
    """The file that has the channel open."""

    def __init__(self, channel: Channel, buffers: Buffers, closed: Callable[[DmaSession], None]) -> None:
        self._channel = channel
        self._closed = closed
        super().__init__(
            buffers,
            protocol.DMA_IOC_INFO,
            {
                protocol.DMA_IOC_INFO: self._info,
                protocol.DMA_IOC_SUBMIT: self._submit,
                protocol.DMA_IOC_SUBMIT_VIDEO: self._submit_video,
                protocol.DMA_IOC_CANCEL: self._cancel,
            },
        )

    def close(self) -> None:
        """The file was closed: stop, then give the memory back."""
        self._channel.release()
        self.buffers.close()
        self._closed(self)

    def _info(self, payload: bytes) -> bytes:
        protocol.require_zero(protocol.unpack(protocol.DMA_INFO, payload)[0])
        spec = self._channel.spec
        direction = protocol.MM2S if spec.direction is Direction.MM2S else protocol.S2MM
        frame = spec.frame_length if spec.is_camera else 0
        kind, caps, longest = _kind(spec)
        name = spec.name.encode()
        info = protocol.DMA_INFO.pack(
            len(payload), 0, direction, kind, caps, QUEUE_DEPTH, longest, _ALIGNMENT, frame, name
        )
        return fit(info, payload)

    def _submit(self, payload: bytes) -> bytes:
        fields = protocol.unpack(protocol.DMA_SUBMIT, payload)
        flags, handle, reserved, offset, length, period, cookie = fields
        protocol.require_zero(flags & ~protocol.SUBMIT_CYCLIC, reserved)
        if self._channel.spec.vdma:
            raise NodeError(errno.EOPNOTSUPP, "a VDMA moves frames of lines")
        cyclic = bool(flags & protocol.SUBMIT_CYCLIC)
        buffer = self._buffer(handle)
        _check_range(buffer, offset, length, _kind(self._channel.spec)[2])
        if cyclic != bool(period) or (cyclic and length % period):
            raise NodeError(errno.EINVAL, "a cyclic transfer, and no other, has a period that divides its length")
        view = buffer.bytes[offset : offset + length]
        self._channel.submit(Transfer(buffer, view, cookie, period, (handle, offset)))
        return payload

    def _submit_video(self, payload: bytes) -> bytes:
        fields = protocol.unpack(protocol.DMA_SUBMIT_VIDEO, payload)
        flags, handle, lines, offset, line_bytes, stride, cookie = fields
        protocol.require_zero(flags & ~protocol.SUBMIT_CYCLIC)
        if self._channel.spec.simple:
            raise NodeError(errno.EOPNOTSUPP, "without scatter/gather there can be no gaps between lines")
        buffer = self._buffer(handle)
        if not lines or not line_bytes or stride < line_bytes:
            raise NodeError(errno.EINVAL, "a frame has lines of at least one byte, and strides that hold them")
        if line_bytes > (MAX_LINE if self._channel.spec.vdma else MAX_LENGTH):
            raise NodeError(errno.EMSGSIZE, "the line is longer than one may be")
        if offset + (lines - 1) * stride + line_bytes > buffer.length:
            raise NodeError(errno.EINVAL, "the frame is not inside the buffer")
        view = np.lib.stride_tricks.as_strided(
            buffer.bytes[offset:], (lines, line_bytes), (stride, 1), writeable=buffer.writable
        )
        period = view.size if flags & protocol.SUBMIT_CYCLIC else 0
        self._channel.submit(Transfer(buffer, view, cookie, period))
        return payload

    def _cancel(self, payload: bytes) -> bytes:
        protocol.require_zero(*protocol.unpack(protocol.DMA_CANCEL, payload))
        self._channel.cancel()
        return payload

    def _buffer(self, handle: int) -> Buffer:
        buffer = self.buffers.get(handle)
        if self._channel.spec.direction is Direction.S2MM and not buffer.writable:
            raise NodeError(errno.EACCES, "the device cannot write to this buffer")
        return buffer


def _kind(spec: ChannelSpec) -> tuple[int, int, int]:
    """Type, capabilities and longest transfer."""
    if spec.vdma:
        return protocol.TYPE_VDMA, _VDMA_CAPS, MAX_LINE
    if spec.simple:
        told = 0 if spec.blind else protocol.CAP_RESIDUE
        return protocol.TYPE_AXIDMA, protocol.CAP_SIMPLE | protocol.CAP_CYCLIC | told, (1 << spec.simple) - 1
    return protocol.TYPE_AXIDMA, _CAPS, MAX_LENGTH


def _check_range(buffer: Buffer, offset: int, length: int, longest: int) -> None:
    if length > longest:
        raise NodeError(errno.EMSGSIZE, f"{length} bytes are more than one transfer may move")
    if length <= 0 or offset + length > buffer.length:
        raise NodeError(errno.EINVAL, "the range is empty or not inside the buffer")

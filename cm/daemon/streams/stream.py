# SPDX-License-Identifier: Apache-2.0
"""An open stream: its DMA channel and slots, handed to the data plane, which moves the frames.

What each frame needs is done by the plane's C thread (`cm.device.data_plane`); here streams are opened,
given memory, measured and closed, in the loop's thread.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from cm.daemon.streams.figures import median, rate, transfer_error
from cm.daemon.streams.peer import Peer
from cm.daemon.streams.settings import frame_bytes, setup
from cm.daemon.streams.shares import EACH, RESERVE, NoSlots, share
from cm.daemon.streams.sharing import for_readers, for_writers
from cm.device import AxiDma, DeviceGone, DmaBuffer, DmaInfo, DmaType
from cm.device.data_plane import Plane
from cm.errors import CmError
from cm.manager.reporting.status import stream_status
from cm.messages.status import ErrorInfo, FrameInfo, StreamClient, StreamStatus
from cm.metrics.counts import Moved
from cm.schema.model import Direction, Stream
from cm.wire.plane_packets import SLOTS_MAX, Descriptor, Geometry, encode_geometry, encode_label

DEPTH = 4  # frames that a local client may hold if it does not say


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its description and its bytes, which are valid during the call only."""

    info: FrameInfo
    data: memoryview


Done = Callable[[Frame | CmError], None]


class OpenStream:
    """An open stream."""

    def __init__(self, plane: Plane, dma: AxiDma, stream: Stream, each: int = EACH) -> None:
        """Take over an open channel; it is closed if this raises. `each`: slots that one process may hold."""
        self.each = each
        self._plane = plane
        self._dma = dma
        self.stream = stream
        self.writes = stream.direction is Direction.MM2S
        self._names = ("", "")
        self.slots: list[DmaBuffer] = []
        self._shared: list[int] = []  # descriptors as clients get them
        self._depths: dict[int, int] = {}
        self._peers: dict[int, Peer] = {}
        try:
            self.setup = setup(dma.info, stream)
            self.id = plane.start(dma, self.setup)
        except BaseException:
            dma.close()
            raise
        self._started = self.writes
        try:
            if not self.writes:
                self._grow(min(stream.slots, SLOTS_MAX))
        except BaseException:
            self.close()
            raise

    def start(self) -> None:
        """Let frames come: clients that are attached by now miss none."""
        self._started = True
        self._hand_over()

    # ---- memory ---------------------------------------------------------------------

    def _grow(self, count: int) -> None:
        while len(self.slots) < count:
            self.slots.append(self._dma.allocate(self.setup.length))
        if self._started:
            self._hand_over()

    def _hand_over(self) -> None:
        for slot in self.slots[len(self._shared) :]:
            self._shared.append(for_writers(slot) if self.writes else for_readers(slot))
            self._plane.add_slot(self.id, self._shared[-1], slot.handle)

    def _make_room(self, depth: int) -> None:
        """So many slots that readers who hold all they may still leave some to the hardware."""
        wanted = sum(self._depths.values()) + depth + (0 if self.writes else RESERVE)
        if self.stream.backpressure and not self.writes:
            return
        name = self.stream.name
        if wanted > SLOTS_MAX:
            raise NoSlots(f"stream {name!r} has {len(self._depths)} clients; with one more it needs {wanted} slots")
        try:
            self._grow(wanted)
        except OSError as error:
            raise NoSlots(
                f"stream {name!r}: no memory for a client of {depth} frames more ({error}); "
                "close others, or ask for a smaller depth"
            ) from error

    # ---- clients --------------------------------------------------------------------

    def attach(self, client: int, depth: int, peer: Peer | None = None) -> bool:
        """Let a client of the plane read or write; False if it has gone. Raises NoSlots."""
        depth = max(1, min(depth or DEPTH, SLOTS_MAX - RESERVE))
        if peer is not None:
            ours = Peer.ourselves()
            held = [(self._peers[at], slots) for at, slots in self._depths.items() if self._peers[at] != ours]
            depth = share(self.stream.name, depth, peer, held, self.each)
        self._make_room(depth)
        if not self._plane.attach(client, self.id, depth, encode_geometry(self._geometry(depth))):
            return False
        self._depths[client] = depth
        self._peers[client] = peer or Peer.ourselves()
        return True

    def detached(self, client: int) -> None:
        """A client has gone."""
        self._depths.pop(client, None)
        self._peers.pop(client, None)

    @property
    def channel(self) -> DmaInfo:
        """What the channel can do."""
        return self._dma.info

    @property
    def clients(self) -> int:
        """How many are attached."""
        return len(self._depths)

    def _geometry(self, depth: int) -> Geometry:
        s = self.stream
        coherent = all(slot.coherent for slot in self.slots)
        return Geometry(
            slot_length=self.slots[0].length,
            frame_length=frame_bytes(s),
            coherent=coherent,
            writable=self.writes,
            cyclic=self.setup.cyclic,
            depth=depth,
            stride=self.setup.stride if self.setup.stride != self.setup.line_bytes else 0,
            shape=s.shape,
            dtype=s.dtype,
            stream=s.name,
            config_name=self._names[0],
            mode=self._names[1],
        )

    def label(self, config: str, mode: str) -> None:
        """Frames from here on belong to this mode."""
        if (config, mode) != self._names:
            self._names = (config, mode)
            self._plane.tell(self.id, encode_label(self.stream.name, config, mode))

    # ---- what is told -----------------------------------------------------------------

    def info(self, frame: Descriptor, generation: int = 0) -> FrameInfo:
        """A frame's description; one that is not whole is flat bytes. `generation`: of the registers it began under."""
        whole = frame.length == frame_bytes(self.stream) and self.stream.shape is not None
        return FrameInfo(
            stream=self.stream.name,
            sequence=frame.sequence,
            timestamp_ns=frame.timestamp_ns,
            length=frame.length,
            shape=self.stream.shape if whole and self.stream.shape else (frame.length,),
            dtype=self.stream.dtype if whole else "uint8",
            config_name=self._names[0],
            mode=self._names[1],
            generation=generation,
        )

    def status(self) -> StreamStatus:
        """The stream and its counters."""
        counts = self._plane.counts(self.id)
        return replace(
            stream_status(self.stream),
            slots=len(self.slots) or self.stream.slots,
            open=True,
            frames=counts.frames,
            dropped=counts.dropped,
            errors=counts.errors,
            rate=rate(counts),
            latency_us=median(counts.latency_ns) / 1000,
            clients=tuple(self._clients()),
            exact=not (self.writes or self.channel.tells_length or self.channel.type is DmaType.VDMA),
            max_length=self.channel.max_length,
            last_error=transfer_error(counts, self.setup),
        )

    def moved(self) -> Moved:
        """What it moved since it was opened."""
        counts = self._plane.counts(self.id)
        return Moved(counts.frames, counts.dropped, counts.errors, counts.bytes)

    def failure(self) -> ErrorInfo | None:
        """Why a transfer failed last, if one has."""
        return transfer_error(self._plane.counts(self.id), self.setup)

    def _clients(self) -> Iterator[StreamClient]:
        for client, peer in self._peers.items():
            counts = self._plane.client_counts(client)
            if counts is not None:
                yield StreamClient(
                    peer.pid, peer.name, self.writes, counts.depth, counts.held, counts.frames, counts.dropped
                )

    def close(self, error: int = 0) -> None:
        """Stop the channel and release everything; clients are told, and keep what they have mapped."""
        try:
            self.release(error)
        finally:
            self._dma.close()

    def release(self, error: int = 0) -> AxiDma:
        """The same, but the channel stays open, and is the caller's from here on."""
        self._plane.stop(self.id, error)
        try:
            with suppress(DeviceGone):
                for slot in self.slots:
                    slot.close()
        finally:
            for fd in self._shared:
                os.close(fd)
            self._shared.clear()
        return self._dma

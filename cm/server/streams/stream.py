# SPDX-License-Identifier: Apache-2.0
"""An open stream: its DMA channel and slots, handed to the data plane, which moves the frames; and its figures.

The plane's C thread (`cm.device.data_plane`) does all work per frame; streams are opened, measured and closed here,
in the loop's thread. `machine` says what is to be done, a few slots in each step.
"""

from __future__ import annotations

import errno
import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

from cm.device import AxiDma, DeviceGone, DmaBuffer, DmaInfo, DmaType
from cm.device.data_plane import Plane, StreamCounts, StreamSetup
from cm.errors import InvalidRequest
from cm.frozen import dataclass, replace
from cm.manager.status_reports import stream_status
from cm.schema.model import Direction, Stream
from cm.server.streams.channel_setup import frame_bytes, longest, setup
from cm.server.streams.machine import DEPTH, Step, StepKind, StreamMachine, StreamPhase
from cm.wire.messages.status import ErrorInfo, FrameInfo, StreamClient, StreamStatus
from cm.wire.plane_packets import Descriptor, Geometry, encode_geometry, encode_label

_F_SEAL_FUTURE_WRITE = 0x0010  # linux/fcntl.h; the module has it from Python 3.13 on


def for_readers(slot: DmaBuffer) -> int:
    """Return a descriptor that readers can neither map writable nor reopen so, if it is a memfd (a simulated board).

    A dma-buf takes no seals and cannot be reopened: see docs/security.md.
    """
    if slot.coherent:  # otherwise it has counters beside its content, which readers write to
        _seal(slot.fd, _F_SEAL_FUTURE_WRITE | fcntl.F_SEAL_SEAL)
    try:
        return os.open(f"/proc/self/fd/{slot.fd}", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return os.dup(slot.fd)


def for_writers(slot: DmaBuffer) -> int:
    """Return a descriptor for writers, none of whom can seal the memory against the others."""
    _seal(slot.fd, fcntl.F_SEAL_SEAL)
    return os.dup(slot.fd)


def _seal(fd: int, seals: int) -> None:
    with suppress(OSError):  # a dma-buf, or Linux before 5.1
        fcntl.fcntl(fd, fcntl.F_ADD_SEALS, seals)


AT_ONCE = 8  # slots allocated, given or freed in one step
_LONG = 200_000  # nanoseconds after which a step ends even if it allocated fewer


def median(values: Sequence[int]) -> int:
    """Return the median; 0 for no values. (Importing `statistics` would cost half a MiB.)"""
    return sorted(values)[len(values) // 2] if values else 0


def rate(counts: StreamCounts) -> float:
    """Return the frames per second over the last second."""
    now = time.monotonic_ns()
    recent = [t for t in counts.at_ns if t > now - 1_000_000_000]
    return (
        (len(recent) - 1) * 1e9 / (recent[-1] - recent[0])
        if len(recent) > 1 and recent[-1] > recent[0]
        else float(len(recent))
    )


def transfer_error(counts: StreamCounts, writes: bool) -> ErrorInfo | None:
    """Say why a transfer last failed; None if none has."""
    if not counts.error:
        return None
    after = f" after {counts.came}" if counts.came else ""
    text = f"a transfer of {counts.asked} bytes failed{after}: {os.strerror(counts.error)}"
    if counts.error == errno.EIO and not writes:
        text += "; the packet was longer than the frame, or the bus reported an error"
    return ErrorInfo("transfer_failed", text)


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame: its description and its bytes, which are valid only until the call that receives it returns."""

    info: FrameInfo
    data: memoryview


Done = Callable[[Frame | Exception], None]


class OpenStream:
    """An open stream."""

    def __init__(self, plane: Plane, dma: AxiDma, stream: Stream, machine: StreamMachine) -> None:
        """Take over an open channel, which is closed if this raises."""
        self._plane = plane
        self._dma = dma
        self.stream = stream
        self.machine = machine
        self.writes = stream.direction is Direction.MM2S
        self._names = ("", "")
        self.driven = False  # whether steps are being taken
        try:
            most = longest(dma.info, stream)
            self.setup = StreamSetup(True, most, lent=DEPTH) if machine.is_lent else setup(dma.info, stream)
            if self.setup.lent and dma.info.type is DmaType.VDMA:
                raise InvalidRequest(f"stream {stream.name!r}: channel {dma.info.name} is a VDMA's, which moves lines")
            self.id = plane.start(dma, self.setup)
        except BaseException:
            dma.close()
            raise
        self.slots: list[DmaBuffer] = []  # its memory; the index is the slot number in the plane's packets
        self._given: list[int] = []  # the descriptors that clients get, for the slots that the plane has already
        self._awaiting_start: list[Callable[[Exception | None], None]] = []

    def take(self, step: Step) -> None:
        """Do what the machine says is next, and report it there. Raises DeviceError."""
        made, given = self.slots, self._given
        if step.kind is StepKind.ALLOCATE:
            began = time.monotonic_ns()
            for _ in range(min(AT_ONCE, step.slots - len(made))):
                made.append(self._dma.allocate(self.setup.length))  # those made by then stay
                if time.monotonic_ns() - began > _LONG:
                    break
        elif step.kind is StepKind.GIVE:
            for slot in made[len(given) : step.slots][:AT_ONCE]:
                given.append(for_writers(slot) if self.writes else for_readers(slot))
                self._plane.add_slot(self.id, given[-1], slot.handle)
        elif step.kind is StepKind.FREE:
            for _ in range(min(AT_ONCE, len(made) - len(given))):
                made.pop().close()
        elif step.member is not None:
            client, depth = step.member.client, step.member.depth
            if not self._plane.attach(client, self.id, depth, encode_geometry(self._geometry(depth))):  # it has gone
                self.machine.left(client)
                return
        self.machine.took(step, len(made), len(given))
        if step.kind is StepKind.START:
            self.started()

    def when_started(self, answer: Callable[[Exception | None], None]) -> None:
        """Call `answer` with None once the stream has started or been stopped, or with the error that prevents it."""
        if self.machine.phase is StreamPhase.RUNNING:
            answer(None)
        else:
            self._awaiting_start.append(answer)

    def started(self, error: Exception | None = None) -> None:
        """Answer those that wait for the start."""
        waiting, self._awaiting_start = self._awaiting_start, []
        for answer in waiting:
            answer(error)

    @property
    def channel(self) -> DmaInfo:
        """The channel's properties."""
        return self._dma.info

    def _geometry(self, depth: int) -> Geometry:
        s = self.stream
        if self.setup.lent:
            most, (config, mode) = self.setup.length, self._names
            return Geometry(most, writable=self.writes, depth=depth, stream=s.name, config_name=config, mode=mode)
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
            format=s.format or "",
        )

    def label(self, config: str, mode: str) -> None:
        """Label the frames from here on as belonging to this mode."""
        if (config, mode) != self._names:
            self._names = (config, mode)
            self._plane.tell(self.id, encode_label(self.stream.name, config, mode))

    # ---- reports ----------------------------------------------------------------------

    def info(self, frame: Descriptor, generation: int = 0, failed: int = 0) -> FrameInfo:
        """Describe a frame; an incomplete one is flat bytes. `generation`: of the registers under which it began.

        `failed`: transfers of the stream that failed before it.
        """
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
            format=(self.stream.format or "") if whole else "",
            failed=failed,
        )

    def status(self) -> StreamStatus:
        """The stream and its counters."""
        counts = self._plane.counts(self.id)
        return replace(
            stream_status(self.stream),
            slots=0 if self.setup.lent else len(self.slots) or self.stream.slots,
            open=True,
            frames=counts.frames,
            dropped=counts.dropped,
            errors=counts.errors,
            rate=rate(counts),
            latency_us=median(counts.latency_ns) / 1000,
            clients=tuple(self._clients()),
            exact=not (self.writes or self.channel.tells_length or self.channel.type is DmaType.VDMA),
            max_length=longest(self.channel, self.stream),
            slot_bytes=self.setup.length,
            last_error=transfer_error(counts, self.writes),
        )

    def failure(self) -> ErrorInfo | None:
        """Why a transfer last failed, or None."""
        return transfer_error(self._plane.counts(self.id), self.writes)

    def _clients(self) -> Iterator[StreamClient]:
        for client, peer in self.machine.joined.items():
            counts = self._plane.client_counts(client)
            if counts is not None:
                yield StreamClient(
                    peer.pid, peer.name, self.writes, counts.depth, counts.held, counts.frames, counts.dropped
                )

    def close(self, error: int = 0) -> None:
        """Stop the channel and release everything; clients are told `error`, and keep the memory they have mapped."""
        self._plane.stop(self.id, error)
        try:
            self._dma.close()  # frees all slots at once; one by one would take as long as allocating them
        finally:
            while self._given:
                os.close(self._given.pop())
            with suppress(DeviceGone):
                for slot in self.slots:
                    slot.close()

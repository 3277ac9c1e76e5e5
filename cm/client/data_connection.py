# SPDX-License-Identifier: Apache-2.0
"""A connection to the manager's data socket: packets become frames, grants and errors. No waiting of its own."""

from __future__ import annotations

import errno
import math
import os
import select
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from cm.client.after_fork import not_for_children
from cm.client.data_socket import LIMITS_ARE_KNOWN, connect, descriptors, limit
from cm.client.errors import ConnectionLost, LateRelease, request_error
from cm.client.frame import Frame, in_rgb
from cm.client.mapping import LocalFrame, SlotMappings, lend
from cm.errors import CmError
from cm.wire import plane_packets as packets
from cm.wire.messages.status import ErrorInfo
from cm.wire.plane_packets import DESCRIPTOR, FDS_MAX, PACKET_MAX, Descriptor, Geometry, Open

_ANCILLARY = socket.CMSG_SPACE(FDS_MAX * 4)
_SEQUENCES = 1 << 64
# as plain numbers: operators of the enumerations they come from cost more than the system call
_CLOEXEC = int(socket.MSG_CMSG_CLOEXEC)
_NOSIGNAL = int(socket.MSG_NOSIGNAL)
_DONTWAIT = int(socket.MSG_DONTWAIT)


class DataConnection:
    """One stream of the plane, to be read or written.

    `receive()` blocks for at most the socket's time-out (`set_timeout`) and handles one packet.
    """

    def __init__(self, folder: Path, wanted: Open) -> None:
        """Connect, and open the stream. Raises NotFound if no manager serves the folder's data socket."""
        self.wanted = wanted
        self.memory: SlotMappings | None = None
        self._left: SlotMappings | None = None  # of frames that are still held after `close`
        self._owner = os.getpid()
        self._disowned = False
        self.names = ("", "", "")
        self.generation = 0  # of the registers, under which the frames that come began; 0: not known
        self.address = 0  # of memory that was asked for, as devices see it
        self.lost = 0
        self._failed = self._told = 0  # transfers of the stream, by now and at the frame before
        self.held = 0
        self.done: deque[Descriptor] = deque()
        self.granted: deque[Descriptor] = deque()
        self.stopped = 0  # times that the stream was stopped, so far
        self._expected: int | None = None
        self._timeout: float | None = None
        self._polls = False
        self._buffer = bytearray(PACKET_MAX)
        self._handlers: dict[int, Callable[[Descriptor, int, list[int]], None]] = {
            packets.GEOMETRY: self._geometry,
            packets.SLOTS: self._slots,
            packets.LABEL: self._label,
            packets.GENERATION: self._generation,
            packets.FAILED: self._transfers_failed,
            packets.ADDRESS: self._address,
            packets.STOPPED: self._stopped,
            packets.REFUSED: self._refused,
            packets.LATE: self._late,
            packets.GRANT: lambda head, _, __: self.granted.append(head),
            packets.DONE: lambda head, _, __: self.done.append(head),
            packets.PONG: lambda head, _, __: self.done.append(head),
        }
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._readable = select.poll()
        self._readable.register(self.socket, select.POLLIN)
        try:
            connect(self.socket, folder)
            self.socket.send(packets.encode_open(wanted))
        except BaseException:
            self.socket.close()
            raise
        not_for_children(self)

    def disown(self) -> None:
        """This process was forked: it hangs up by closing its copy of the socket, which its parent does not notice."""
        self._disowned = True
        memory, self.memory, self._left = self.memory or self._left, None, None
        self.granted.clear()
        if memory is not None:
            memory.disown()
        self.socket.close()

    @property
    def geometry(self) -> Geometry | None:
        """What comes now; None before the first answer, and while the stream is stopped."""
        return self.memory.geometry if self.memory else None

    def set_timeout(self, seconds: float | None) -> None:
        """How long `receive` waits: None for ever.

        By SO_RCVTIMEO, which costs nothing where it stays the same, but takes 0 for ever: that polls, as do systems
        where it is not known.
        """
        if seconds == self._timeout:
            return
        self._timeout = seconds
        self._polls = seconds is not None and (seconds <= 0 or not LIMITS_ARE_KNOWN)
        if LIMITS_ARE_KNOWN:
            limit(self.socket, None if self._polls else seconds)

    def receive(self, flags: int = 0) -> Frame | None:
        """Handle one packet; the frame if it was one. Raises BlockingIOError at the time-out, ConnectionLost, …"""
        if self._polls and not flags:
            self._await_packet(self._timeout or 0.0)
        try:
            size, ancillary, _, _ = self.socket.recvmsg_into([self._buffer], _ANCILLARY, flags | _CLOEXEC)
        except (ConnectionError, TimeoutError) as error:
            raise ConnectionLost(f"the configuration manager's data socket: {error}") from error
        except OSError as error:
            if error.errno == errno.EBADF:
                raise ConnectionLost("the data socket was closed by another thread") from None
            raise
        if not size:
            raise ConnectionLost("the configuration manager hung up on the data socket")
        head = Descriptor._make(DESCRIPTOR.unpack_from(self._buffer))
        fds = descriptors(ancillary) if ancillary else []
        if fds and head.kind != packets.SLOTS:
            _close(fds)
        try:
            if size < DESCRIPTOR.size:
                raise ValueError(f"{size} bytes")
            if head.kind == packets.FRAME and self.memory is not None:
                return self._frame(self.memory, head)
            handler = self._handlers.get(head.kind)
            if handler is not None:
                handler(head, size, fds)
        except CmError:
            raise
        except (LookupError, OverflowError, TypeError, ValueError) as error:
            raise ConnectionLost(f"the data socket's packet of kind {head.kind} cannot be used: {error}") from error
        return None

    def take(self) -> Frame | None:
        """As `receive`, but never waits. Raises BlockingIOError if nothing is there."""
        return self.receive(_DONTWAIT)

    def waiting(self) -> bool:
        """Whether a packet is there, or the end of the connection."""
        return bool(self._readable.poll(0))

    def _await_packet(self, seconds: float) -> None:
        if not self._readable.poll(math.ceil(seconds * 1000)):
            raise BlockingIOError(errno.EAGAIN, f"no packet within {seconds:g} s")

    def _frame(self, memory: SlotMappings, head: Descriptor) -> Frame:
        lost = failed = 0
        if self._expected is not None and head.sequence != self._expected:
            lost = (head.sequence - self._expected) % _SEQUENCES
            failed = min(self._failed - self._told, lost)
            self.lost += lost
        self._expected, self._told = head.sequence + 1, self._failed
        self.held += 1
        try:
            frame = lend(memory, head, self.names, self.give_back, (self.generation, failed, lost))
        except (LookupError, TypeError, ValueError):  # it lies in none of our slots: there is nothing to give back
            self.held -= 1
            raise
        return self._in_rgb(frame, memory.geometry.format) if memory.coded and not self.wanted.raw else frame

    def _in_rgb(self, frame: LocalFrame, form: str) -> Frame:
        """A copy in RGB, for which the slot is not needed any more; a frame that was cut short is bytes as they are."""
        if frame.ndim != 3:
            return frame
        try:
            return in_rgb(np.asarray(frame), form, frame.info)
        finally:
            frame.release()

    def give_back(self, memory: SlotMappings, frame: Descriptor) -> None:
        """Release a frame; if the stream was stopped meanwhile nothing is sent: its memory is not used again."""
        if self._disowned:  # the parent may still look at it
            return
        memory.end(frame.slot)
        if memory is not self.memory and memory is not self._left:
            return
        self.held -= 1
        with suppress(OSError):
            release = (frame.slot, packets.RELEASE, *frame[2:])
            self.socket.send(DESCRIPTOR.pack(*release), _NOSIGNAL)
        if memory is self._left and not self.held:
            self._left = None
            self.socket.close()

    def submit(self, slot: Descriptor, offset: int, length: int, sequence: int) -> None:
        """Send a granted slot to the hardware. Raises ConnectionLost."""
        self.send(Descriptor(slot.slot, packets.SUBMIT, slot.flags, offset, length, sequence, slot.timestamp_ns))

    def send(self, packet: Descriptor) -> None:
        """Send a packet. Raises ConnectionLost."""
        try:
            self.socket.send(DESCRIPTOR.pack(*packet), _NOSIGNAL)
        except OSError as error:
            raise ConnectionLost(f"the configuration manager's data socket: {error}") from error

    def close(self) -> None:
        """Disconnect; frames that are held remain valid until they are given back. Twice is fine."""
        if os.getpid() != self._owner:
            self.disown()
        if self._left is not None or self._disowned:
            return
        memory = self._left = self.memory  # in this order: another thread may give back its last frame just now
        self.memory = None
        self.granted.clear()
        if memory is not None:
            memory.close()
        if memory is None or not self.held or not self._leave():
            self._left = None
            with suppress(OSError):
                self.socket.shutdown(socket.SHUT_RD)  # a thread that waits there does not notice close() alone
            self.socket.close()

    def _leave(self) -> bool:
        """Take no more frames; those that wait go back unseen. False if the manager has gone."""
        try:
            self.socket.shutdown(socket.SHUT_RD)
            while self.socket.recv_into(self._buffer, 0, _DONTWAIT):  # closes descriptors that come along
                head = Descriptor._make(DESCRIPTOR.unpack_from(self._buffer))
                if head.kind == packets.FRAME:
                    self.socket.send(head._replace(kind=packets.RELEASE).pack(), _NOSIGNAL)
            self.socket.send(Descriptor(kind=packets.LEAVE).pack(), _NOSIGNAL)
        except OSError:
            return False
        return True

    # ---- packets -----------------------------------------------------------------------

    def _geometry(self, head: Descriptor, size: int, _: list[int]) -> None:
        self._end_memory()
        geometry = packets.decode_geometry(bytes(self._buffer[:size]))
        self.memory = SlotMappings(geometry, head.flags)
        self.names = self.memory.names
        self._expected = None
        self.generation = self._failed = 0

    def _slots(self, head: Descriptor, _: int, fds: list[int]) -> None:
        if self.memory is None or head.offset != len(fds):
            _close(fds)
            if self.memory is not None:  # with one missing, each later number would be another's
                raise ConnectionLost(
                    f"{len(fds)} of {head.offset} slots came: this process may have no room for more files"
                )
            return
        try:
            self.memory.add(head.slot, fds)
        except OSError as error:
            raise ConnectionLost(f"the manager's slots cannot be mapped: {error}") from error

    def _label(self, _: Descriptor, size: int, __: list[int]) -> None:
        stream, config, mode = packets.decode_names(bytes(self._buffer[DESCRIPTOR.size : size]))
        self.names = (stream, config, mode)

    def _address(self, head: Descriptor, _: int, __: list[int]) -> None:
        self.address = head.sequence

    def _generation(self, head: Descriptor, _: int, __: list[int]) -> None:
        self.generation = head.sequence

    def _transfers_failed(self, head: Descriptor, _: int, __: list[int]) -> None:
        self._failed = head.sequence

    def _stopped(self, _: Descriptor, __: int, ___: list[int]) -> None:
        self._end_memory()
        self.stopped += 1

    def _end_memory(self) -> None:
        memory, self.memory = self.memory, None
        if memory is not None:
            memory.close()
        self.granted.clear()
        self.held = 0

    def _refused(self, _: Descriptor, size: int, __: list[int]) -> None:
        raise request_error(ErrorInfo(*packets.decode_refused(bytes(self._buffer[:size]))))

    def _late(self, head: Descriptor, _: int, __: list[int]) -> None:
        raise LateRelease(
            f"frame {head.sequence} of {self.names[0]!r} was given back, but slot {head.slot} is not ours: "
            "its content was not ours either"
        )


def _close(fds: list[int]) -> None:
    for fd in fds:
        os.close(fd)

# SPDX-License-Identifier: Apache-2.0
"""The local data plane: its C thread, streams and clients by number."""

from __future__ import annotations

from typing import NamedTuple

from cm.device.native._cm import ffi, lib
from cm.device.native.call import Handle, check, last_error

CLIENT_GONE: int = lib.CM_PLANE_CLIENT_GONE
STREAM_LOST: int = lib.CM_PLANE_STREAM_LOST
CLIENT_LEAVES: int = lib.CM_PLANE_CLIENT_LEAVES


class Event(NamedTuple):
    """``struct cm_plane_event``."""

    kind: int
    id: int
    error: int


class StreamCounts(NamedTuple):
    """What happened since a stream's start; of recent frames, the times of completion and latencies (ns), newest last.

    `error`: the errno of the last transfer that failed, 0 if none has; `asked`, `came`: bytes of it.
    """

    frames: int
    dropped: int
    errors: int
    bytes: int
    late: int
    held: int
    queued: int
    idle: int
    error: int
    asked: int
    came: int
    at_ns: tuple[int, ...]
    latency_ns: tuple[int, ...]


class ClientCounts(NamedTuple):
    """One client since it was attached: frames it was lent or sent, and did not get; slots it may hold, and holds."""

    frames: int
    dropped: int
    depth: int
    held: int


class Setup(NamedTuple):
    """``struct cm_plane_setup``."""

    write: bool
    backpressure: bool
    cyclic: bool
    queue_depth: int
    length: int
    lines: int
    line_bytes: int
    stride: int
    period_ns: int
    lent: int
    address: int


def new() -> Handle:
    """Start a plane; `close` ends it."""
    plane = lib.cm_plane_new()
    if plane == ffi.NULL:
        raise last_error()
    return plane


def close(plane: Handle) -> None:
    """End the thread and free everything; nothing may use ``plane`` any more."""
    lib.cm_plane_close(plane)


def event_fd(plane: Handle) -> int:
    """Return the descriptor that polls readable when an event waits."""
    return int(lib.cm_plane_event_fd(plane))


def take(plane: Handle) -> Event | None:
    """Take an event, if one is there."""
    event = ffi.new("struct cm_plane_event *")
    return Event(event.kind, event.id, event.error) if lib.cm_plane_take(plane, event) else None


def start(plane: Handle, dma: Handle | None, setup: Setup) -> int:
    """Begin a stream; ``dma`` is a channel's handle, None for an echo."""
    raw = ffi.new("struct cm_plane_setup *", setup)
    return check(lib.cm_plane_start(plane, ffi.NULL if dma is None else dma, raw))


def add_slot(plane: Handle, stream: int, fd: int, handle: int) -> int:
    """Give a stream memory; returns the slot's number."""
    return check(lib.cm_plane_add_slot(plane, stream, fd, handle))


def stop(plane: Handle, stream: int, error: int) -> None:
    """End a stream; no transfer is under way afterwards."""
    check(lib.cm_plane_stop(plane, stream, error))


def adopt(plane: Handle, fd: int) -> int:
    """Take over a connected socket; returns the client's number."""
    return check(lib.cm_plane_adopt(plane, fd))


def attach(plane: Handle, client: int, stream: int, depth: int, packet: bytes) -> None:
    """Attach a client to a stream."""
    check(lib.cm_plane_attach(plane, client, stream, depth, packet, len(packet)))


def tell(plane: Handle, stream: int, packet: bytes) -> None:
    """Send a packet to all clients of a stream."""
    check(lib.cm_plane_tell(plane, stream, packet, len(packet)))


wrote = lib.cm_plane_wrote


def settle(plane: Handle) -> None:
    """Handle what clients have sent by now, so that those that hung up before are gone."""
    lib.cm_plane_settle(plane)


def drop(plane: Handle, client: int) -> None:
    """Hang up on a client."""
    check(lib.cm_plane_drop(plane, client))


def stats(plane: Handle, stream: int) -> StreamCounts:
    """The counters of a stream."""
    raw = ffi.new("struct cm_plane_stats *")
    check(lib.cm_plane_get_stats(plane, stream, raw))
    recent = tuple(raw.at_ns)[: raw.count], tuple(raw.latency_ns)[: raw.count]
    counts = raw.frames, raw.dropped, raw.errors, raw.bytes, raw.late, raw.held, raw.queued, raw.idle, raw.error
    return StreamCounts(*counts, raw.asked, raw.came, *recent)


def client_stats(plane: Handle, client: int) -> ClientCounts:
    """What one client has received, and what it holds."""
    raw = ffi.new("struct cm_plane_client_stats *")
    check(lib.cm_plane_get_client_stats(plane, client, raw))
    return ClientCounts(raw.frames, raw.dropped, raw.depth, raw.held)

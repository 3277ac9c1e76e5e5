# SPDX-License-Identifier: Apache-2.0
"""The frames before a command: the return path, as in ROUTER, REQ and DEALER sockets."""

from __future__ import annotations

from cm.wire.decode import TOPICS
from cm.wire.request_table import Frame

GUEST = b"for="  # begins the frame before the empty one, if a bridge speaks for a guest


def guest_named(envelope: list[Frame]) -> str:
    """The guest in whose name a bridge asks; empty for a client that asks in its own."""
    said = bytes(envelope[-2]) if len(envelope) > 2 else b""
    return said[len(GUEST) :].decode("utf-8", "replace") or "\0" if said.startswith(GUEST) else ""


def split_envelope(frames: list[Frame]) -> tuple[list[Frame], list[Frame]]:
    """What a ROUTER received → return path, message."""
    cut = envelope_length(frames)
    return frames[:cut], frames[cut:]


def envelope_length(frames: list[Frame]) -> int:
    """How many of the frames that a ROUTER received are the return path.

    A REQ socket puts an empty frame between them; a DEALER may do so, with frames of its own before it, or may send
    the message without. So if the first frame is a topic, there is no return path; otherwise an empty frame that
    others follow ends it. A client's own frames may be anything but a topic.
    """
    if len(frames) > 1 and not frames[1]:  # most do
        return 2
    if len(frames) == 5 and not frames[2] and bytes(frames[1]) not in TOPICS:  # a number before it, as ours have
        return 3
    if len(frames) < 4 or bytes(frames[1]) in TOPICS or b"" not in frames[2:-1]:
        return 1
    return frames.index(b"", 2) + 1

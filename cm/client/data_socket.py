# SPDX-License-Identifier: Apache-2.0
"""The socket ``data`` in a manager's runtime folder, as all that use it connect to it. Linux only; needs no numpy."""

from __future__ import annotations

import array
import math
import os
import socket
import struct
import sys
from pathlib import Path

from cm.client.errors import NotAdmitted
from cm.errors import NotFound
from cm.wire import plane_packets as packets

_TIMEVAL = struct.Struct("@ll")
LIMITS_ARE_KNOWN = sys.maxsize > 1 << 32  # SO_RCVTIMEO's argument differs between 32-bit systems with old and new time


def connect(sock: socket.socket, folder: Path) -> None:
    """Connect by a short name: socket paths hold 107 bytes. Raises NotAdmitted, NotFound."""
    try:
        place = os.open(folder, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            sock.connect(f"/proc/self/fd/{place}/{packets.SOCKET}")
        finally:
            os.close(place)
    except PermissionError as error:
        raise NotAdmitted(f"this user may not use the data socket in {folder}") from error
    except (FileNotFoundError, ConnectionRefusedError) as error:
        raise NotFound(f"no configuration manager serves the data socket in {folder}") from error


def limit(sock: socket.socket, seconds: float | None) -> None:
    """How long a blocking socket waits to receive; None for ever. Costs nothing where it stays the same.

    Only where LIMITS_ARE_KNOWN.
    """
    micro = 0 if seconds is None else max(1, math.ceil(seconds * 1e6))
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(*divmod(micro, 1_000_000)))


def descriptors(ancillary: list[tuple[int, int, bytes]]) -> list[int]:
    """Those that came with a packet; the caller closes them."""
    found = array.array("i")
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == socket.SCM_RIGHTS:
            found.frombytes(data[: len(data) - len(data) % found.itemsize])
    return list(found)

# SPDX-License-Identifier: Apache-2.0
"""What systemd is told (Type=notify)."""

from __future__ import annotations

import os
import socket


def notify_ready() -> None:
    """The manager answers from now on: sd_notify(3)."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.sendto(b"READY=1", address)

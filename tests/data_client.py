# SPDX-License-Identifier: Apache-2.0
"""A client of a daemon's data socket, packet by packet."""

from __future__ import annotations

import os
import socket

from daemon_thread import HUNG, Daemon

from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor, Geometry, Open


class Client:
    """A client of the data socket."""

    def __init__(self, daemon: Daemon, wanted: Open | bytes) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.connect(str(daemon.folder / "run" / packets.SOCKET))  # blocks if the backlog is full
        self.socket.settimeout(HUNG / 1000)
        if wanted:
            self.socket.send(packets.encode_open(wanted) if isinstance(wanted, Open) else wanted)

    def next(self, *kinds: int) -> tuple[Descriptor, bytes, list[int]]:
        """The next packet of one of these kinds, and the descriptors with it."""
        while True:
            data, fds, _, _ = socket.recv_fds(self.socket, packets.PACKET_MAX, packets.FDS_MAX)
            assert data, "hung up"
            head = Descriptor(*packets.DESCRIPTOR.unpack_from(data))
            if head.kind in kinds:
                return head, data, fds
            for fd in fds:
                os.close(fd)

    def geometry(self) -> Geometry:
        return packets.decode_geometry(self.next(packets.GEOMETRY)[1])

    def refusal(self) -> tuple[str, str]:
        return packets.decode_refused(self.next(packets.REFUSED)[1])

    def send(self, head: Descriptor, kind: int) -> None:
        self.socket.send(head._replace(kind=kind).pack())

    def close(self) -> None:
        self.socket.close()

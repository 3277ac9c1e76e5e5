# SPDX-License-Identifier: Apache-2.0
"""Whatever bytes and descriptors a node answers with, the result is a documented error and nothing leaks."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_node import OPEN, REPLY
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cm.device as device

DMA_INFO, DMA_ALLOC = 0xC048C500, 0xC028C501
# Often nearly right, so that more than the first check is reached.
OPS = st.sampled_from([OPEN, DMA_INFO, DMA_ALLOC]) | st.integers(0, 2**32 - 1)
LENGTHS = st.sampled_from([0, 32, 72]) | st.integers(0, 2**32 - 1)
ERRORS = st.sampled_from([0, 5, 16]) | st.integers(-(2**31), 2**31 - 1)
HEADERS = st.builds(REPLY.pack, OPS, ERRORS, LENGTHS, st.just(0))
PACKETS = st.binary(max_size=100) | st.builds(
    lambda header, body: header + body, HEADERS, st.binary(min_size=32, max_size=32) | st.binary(max_size=80)
)


class RawNode:
    """Sends a good or bad greeting, then answers each request with the given packet and descriptors."""

    def __init__(self, root: Path) -> None:
        self.greeting: tuple[bytes, int] = (b"", 0)
        self.answer: tuple[bytes, int] = (b"", 0)
        path = root / "dev/cm_dma/raw"
        path.parent.mkdir(parents=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        folder = os.open(path.parent, os.O_PATH)
        self._listener.bind(f"/proc/self/fd/{folder}/{path.name}")
        os.close(folder)
        self._listener.listen()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._thread.join(60)
        self._listener.close()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                sock, _ = self._listener.accept()
                with sock, contextlib.suppress(OSError):
                    self._serve(sock)

    def _serve(self, sock: socket.socket) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ours, theirs:
            socket.send_fds(sock, [self.greeting[0]], [theirs.fileno()] * self.greeting[1])
            while sock.recv(1 << 17):
                socket.send_fds(sock, [self.answer[0]], [theirs.fileno()] * self.answer[1])


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RawNode, Path]]:
    root = tmp_path_factory.mktemp("raw")
    node = RawNode(root)
    yield node, root
    node.close()


def descriptors() -> int:
    """Open descriptors of this process, which serves the node too: constant while a connection stands."""
    return len(list(Path("/proc/self/fd").iterdir()))


GOOD_GREETING = (REPLY.pack(OPEN, 0, 0, 0), 1)
FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@FUZZ
@given(packet=PACKETS, fds=st.integers(0, 6))
def test_any_greeting_opens_or_is_an_error(raw: tuple[RawNode, Path], packet: bytes, fds: int) -> None:
    node, root = raw
    node.greeting = (packet, fds)
    good = len(packet) == REPLY.size and REPLY.unpack(packet)[:3] == (OPEN, 0, 0) and fds == 1
    try:
        device.AxiDma.open("raw", root).close()
    except device.DeviceError:
        assert not good
    else:
        assert good


@FUZZ
@given(packet=PACKETS, fds=st.integers(0, 6))
def test_any_reply_is_a_result_or_an_error(raw: tuple[RawNode, Path], packet: bytes, fds: int) -> None:
    node, root = raw
    node.greeting, node.answer = GOOD_GREETING, (packet, fds)
    with device.AxiDma.open("raw", root) as channel:
        before = descriptors()
        with contextlib.suppress(device.DeviceError), channel.allocate(4096) as buffer:
            op, error, length, _ = REPLY.unpack_from(packet)
            assert (op, error, length, fds) == (DMA_ALLOC, 0, 32, 1)
            assert buffer.length == struct.unpack_from("=Q", packet, REPLY.size + 8)[0]
            with pytest.raises(device.DeviceError):
                buffer.array()  # what came is a socket, not memory
        assert descriptors() <= before

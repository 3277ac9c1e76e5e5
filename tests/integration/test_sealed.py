# SPDX-License-Identifier: Apache-2.0
"""A reader can only look at the memory that it gets."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
from collections.abc import Iterator

import pytest
from manager_process import CAMERA, Manager, served

from cm.client.data_connection import DataConnection
from cm.wire import plane_packets as packets
from cm.wire.plane_packets import Descriptor, Open, Purpose

_F_SEAL_FUTURE_WRITE = 0x0010


@pytest.fixture(scope="module")
def manager() -> Iterator[Manager]:
    with served(schemas=CAMERA) as (manager, _):
        with manager.connected() as board:
            board.load("camera", "loopback")
        yield manager


class Grabber(DataConnection):
    """A client that keeps the descriptors of its slots."""

    def grab(self) -> list[int]:
        kept: list[int] = []

        def take(head: Descriptor, size: int, fds: list[int]) -> None:
            kept.extend(map(os.dup, fds))
            slots(head, size, fds)

        slots = self._handlers[packets.SLOTS]
        self._handlers[packets.SLOTS] = take
        while not kept:
            self.receive()
        return kept


@pytest.fixture
def reader(manager: Manager) -> Iterator[list[int]]:
    connection = Grabber(manager.runtime, Open("camera"))
    connection.set_timeout(60)
    fds = connection.grab()
    yield fds
    for fd in fds:
        os.close(fd)
    connection.close()


def test_a_reader_cannot_write_to_them_by_its_descriptor_nor_by_another(reader: list[int]) -> None:
    for fd in (reader[0], os.open(f"/proc/self/fd/{reader[0]}", os.O_RDWR)):
        with pytest.raises(PermissionError):
            mmap.mmap(fd, 4096, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE)
        with pytest.raises(OSError, match=r"Bad file|not permitted") as caught:
            os.pwrite(fd, b"forged", 0)
        assert caught.value.errno in (errno.EBADF, errno.EPERM)
    assert fcntl.fcntl(reader[0], fcntl.F_GET_SEALS) & _F_SEAL_FUTURE_WRITE


def test_no_client_can_seal_the_memory_that_writers_share(manager: Manager) -> None:
    connection = Grabber(manager.runtime, Open("to_pl", Purpose.WRITE))
    connection.set_timeout(60)
    fds = connection.grab()
    with pytest.raises(PermissionError):
        fcntl.fcntl(fds[0], fcntl.F_ADD_SEALS, _F_SEAL_FUTURE_WRITE)
    for fd in fds:
        os.close(fd)
    connection.close()

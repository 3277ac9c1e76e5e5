# SPDX-License-Identifier: Apache-2.0
"""Requests of others, relayed as bytes: what becomes of them when the manager goes away."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import pytest
import zmq

from cm.client.aio.relay import Relay
from cm.client.errors import ConnectionLost
from cm.tools.demo.boards import free_ports

HUNG = 30.0


def manager(context: zmq.Context[zmq.Socket[bytes]], port: int) -> zmq.Socket[bytes]:
    """Over TCP: a file of ipc is removed when its socket has been closed, which may be after the next one was bound."""
    socket = context.socket(zmq.ROUTER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.RCVTIMEO, int(HUNG * 1000))
    socket.bind(f"tcp://127.0.0.1:{port + 2}")
    return socket


async def until(condition: Callable[[], bool]) -> None:
    async def poll() -> None:
        while not condition():
            await asyncio.sleep(0.005)

    await asyncio.wait_for(poll(), HUNG)


def test_a_request_that_a_manager_never_got_is_not_for_the_next_one() -> None:
    port = free_ports(3)
    with zmq.Context() as context:

        async def course() -> list[bytes]:
            before: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
            first = manager(before, port)
            relay = Relay(f"tcp://127.0.0.1:{port}")
            await until(lambda: relay.up)
            first.close()
            before.term()  # returns when the connection has ended, which the client has not noticed yet
            time.sleep(0.05)
            lost = asyncio.ensure_future(relay.forward([b"cm_status", b"of the first"]))
            await asyncio.sleep(0)  # it is sent before the client notices that the manager has gone
            with pytest.raises(ConnectionLost):
                await asyncio.wait_for(lost, HUNG)
            second = manager(context, port)
            await until(lambda: relay.up)
            asked = asyncio.ensure_future(relay.forward([b"cm_status", b"of the second"], guest="zenoh:anna"))
            came = await asyncio.to_thread(second.recv_multipart)
            second.send_multipart([*came[:-2], b"cm_status", b"reply"])
            assert await asyncio.wait_for(asked, HUNG) == [b"cm_status", b"reply"]
            second.close()
            await relay.close()
            return came

        came = asyncio.run(course())
    assert came[2:] == [b"for=zenoh:anna", b"", b"cm_status", b"of the second"]

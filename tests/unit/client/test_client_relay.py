# SPDX-License-Identifier: Apache-2.0
"""Requests of others, relayed as bytes: how they go, and what becomes of them when the manager goes away."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import pytest
import zmq

from cm.client.aio.relay import Relay
from cm.client.core import calls
from cm.client.errors import ConnectionLost, NoAnswer, RequestBusy
from cm.tools.demo.boards import free_ports
from cm.wire.encode import encode_reply
from cm.wire.messages.status import ErrorInfo, Reply, Status

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


def relayed(course: Callable[[Relay, zmq.Socket[bytes], list[bool]], Any]) -> None:
    """Go through a course with a relay, a manager and what the relay told of the manager's coming and going."""
    port = free_ports(3)
    with zmq.Context() as context:

        async def whole() -> None:
            served, told = manager(context, port), list[bool]()
            relay = Relay(f"tcp://127.0.0.1:{port}", changed=told.append)
            try:
                await until(lambda: relay.up)
                await course(relay, served, told)
            finally:
                await relay.close()
                served.close()

        asyncio.run(whole())


def test_a_relay_asks_for_itself_and_for_guests_and_keeps_the_answers_apart() -> None:
    async def course(relay: Relay, served: zmq.Socket[bytes], told: list[bool]) -> None:
        own = asyncio.ensure_future(relay.ask(calls.status(), timeout=HUNG))
        first = await asyncio.to_thread(served.recv_multipart)
        guests = asyncio.ensure_future(relay.ask(calls.status(), "web:ann", HUNG))
        second = await asyncio.to_thread(served.recv_multipart)
        assert [first[2:4], second[2:5]] == [[b"", b"cm_status"], [b"for=web:ann", b"", b"cm_status"]]
        assert first[1] != second[1]
        refused = encode_reply(b"cm_status", Reply(error=ErrorInfo("busy", "not now")))
        served.send_multipart([*second[:4], *map(bytes, refused)])
        served.send_multipart([*first[:3], *map(bytes, encode_reply(b"cm_status", Reply(Status("camera", "edge"))))])
        assert (await asyncio.wait_for(own, HUNG)).mode == "edge"
        with pytest.raises(RequestBusy, match="not now"):
            await asyncio.wait_for(guests, HUNG)
        assert told == [True]

    relayed(course)


def test_what_is_not_answered_in_time_is_said_so_and_its_late_answer_is_nobody_elses() -> None:
    async def course(relay: Relay, served: zmq.Socket[bytes], told: list[bool]) -> None:
        with pytest.raises(NoAnswer, match=r"no answer within 0\.125 s"):
            await relay.forward([b"cm_status", b"late"], timeout=0.125)
        late = await asyncio.to_thread(served.recv_multipart)
        asked = asyncio.ensure_future(relay.forward([b"cm_status", b"next"]))
        following = await asyncio.to_thread(served.recv_multipart)
        for came in (late, following):
            served.send_multipart([*came[:-2], b"cm_status", b"to " + came[-1]])
        assert await asyncio.wait_for(asked, HUNG) == [b"cm_status", b"to next"]
        assert told == [True]

    relayed(course)


def test_a_relay_that_is_closed_ends_what_waits_and_tells_no_more() -> None:
    async def course(relay: Relay, served: zmq.Socket[bytes], told: list[bool]) -> None:
        asked = asyncio.ensure_future(relay.forward([b"cm_status", b""]))
        await asyncio.to_thread(served.recv_multipart)
        await relay.close()
        with pytest.raises(ConnectionLost, match=r"no configuration manager answers at tcp://127\.0\.0\.1"):
            await asyncio.wait_for(asked, HUNG)
        assert (told, relay.up) == ([True], False)

    relayed(course)


def test_a_relay_hands_on_what_is_published_until_it_is_told_not_to() -> None:
    port = free_ports(3)
    with zmq.Context() as context, context.socket(zmq.XPUB) as published:
        published.linger = 0
        published.setsockopt(zmq.RCVTIMEO, int(HUNG * 1000))
        published.bind(f"tcp://127.0.0.1:{port}")

        async def course() -> None:
            relay, taken = Relay(f"tcp://127.0.0.1:{port}"), list[list[bytes]]()
            try:
                listening = relay.subscribe(b"cm_status", b"cm_irq", take=taken.append, depth=3)
                heard = {await asyncio.to_thread(published.recv) for _ in range(2)}
                assert heard == {b"\x01cm_status", b"\x01cm_irq"}
                for number in range(40):
                    published.send_multipart([b"cm_status", b"%d" % number])
                    published.send_multipart([b"cm_other", b"0"])
                    await until(lambda number=number: len(taken) > number)
                assert taken == [[b"cm_status", b"%d" % number] for number in range(40)]
                listening.close()
                listening.close()
                heard = {await asyncio.to_thread(published.recv) for _ in range(2)}
                assert heard == {b"\x00cm_status", b"\x00cm_irq"}
            finally:
                await relay.close()

        asyncio.run(course())

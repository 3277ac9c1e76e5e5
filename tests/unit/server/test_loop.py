# SPDX-License-Identifier: Apache-2.0
"""The daemon's loop: no message is left waiting because ZeroMQ's descriptor did not signal it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator

import pytest
import zmq

from cm.server.sockets import Loop
from cm.wire import multipart

MESSAGES = 2000


@pytest.fixture
def context() -> Iterator[zmq.Context[zmq.Socket[bytes]]]:
    with zmq.Context() as made:
        yield made


def pair(context: zmq.Context[zmq.Socket[bytes]], clients: int) -> tuple[zmq.Socket[bytes], list[zmq.Socket[bytes]]]:
    server = context.socket(zmq.ROUTER)
    server.set_hwm(0)
    server.bind("inproc://loop")
    asking = []
    for _ in range(clients):
        client = context.socket(zmq.DEALER)
        client.set_hwm(0)
        client.rcvtimeo = 60_000
        client.connect("inproc://loop")
        asking.append(client)
    return server, asking


def test_every_message_is_served_whatever_is_sent_meanwhile(context):
    """Sending consumes the descriptor's signal: here the loop sends all the time, from other callbacks too."""
    server, clients = pair(context, 3)
    loop = Loop()
    served: list[bytes] = []
    late: list[list[bytes | memoryview]] = []

    def take() -> None:
        identity, number = multipart.receive(server)
        served.append(bytes(number))
        if len(served) % 3:
            loop.send(server, [identity, number])
        else:  # answered later, from a call of its own
            late.append([identity, number])
            loop.call_threadsafe(lambda: loop.send(server, late.pop(0)))

    loop.add_socket(server, take)
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        answers = [0] * len(clients)
        for number in range(MESSAGES):
            for client in clients:
                client.send(b"%d" % number)
            if number % 7 == 0:  # sometimes wait for all, so that the loop goes to sleep in between
                for index, client in enumerate(clients):
                    while answers[index] <= number:
                        client.recv()
                        answers[index] += 1
        for index, client in enumerate(clients):
            while answers[index] < MESSAGES:
                client.recv()
                answers[index] += 1
    finally:
        loop.stop()
        thread.join()
        loop.close()
        for socket in (server, *clients):
            socket.close()
    assert len(served) == MESSAGES * len(clients)


def test_messages_that_were_there_before_the_socket_was_added_are_served(context):
    server, (client,) = pair(context, 1)
    client.send(b"early")
    assert server.poll(60_000)  # its signal is consumed
    loop = Loop()
    loop.add_socket(server, lambda: (loop.send(server, multipart.receive(server)), loop.stop())[1])
    loop.run()
    loop.close()
    assert client.recv() == b"early"
    client.close()
    server.close()


def test_a_timer_set_for_a_message_that_was_looked_for_again_is_not_late(context):
    """Nothing else wakes the loop."""
    server, (client,) = pair(context, 1)
    client.send(b"early")
    assert server.poll(60_000)  # its signal is consumed
    loop = Loop()
    loop.add_socket(server, lambda: (multipart.receive(server), loop.call_later(0.01, loop.stop)))
    thread = threading.Thread(target=loop.run, daemon=True)
    thread.start()
    thread.join(30)
    late = thread.is_alive()
    loop.stop()
    thread.join(30)
    assert not late
    loop.close()
    client.close()
    server.close()


def test_one_busy_socket_does_not_starve_the_others(context):
    """A socket that always has more gets a share; descriptors and calls come in between."""
    server, (client,) = pair(context, 1)
    loop = Loop()
    read_end, write_end = os.pipe()
    seen = []

    def take() -> None:
        loop.send(server, multipart.receive(server))
        client.send(client.recv())  # the next one is there at once

    loop.add_socket(server, take)
    loop.add(read_end, lambda: (seen.append(os.read(read_end, 1)), loop.stop()))
    client.send(b"x")
    os.write(write_end, b"!")
    loop.run()
    loop.close()
    assert seen == [b"!"]
    for socket in (server, client):
        socket.close(linger=0)
    os.close(read_end)
    os.close(write_end)


@pytest.mark.parametrize("frames", [[b""], [b"a", b"", b"b" * 4096], [b"topic", b"x" * 4097, b"y" * 1_000_000, b""]])
def test_frames_arrive_as_they_were_sent(context, frames):
    with context.socket(zmq.PAIR) as one, context.socket(zmq.PAIR) as other:
        one.bind("inproc://pair")
        other.connect("inproc://pair")
        multipart.send(one, frames)
        assert [bytes(frame) for frame in multipart.receive(other)] == frames
        with pytest.raises(zmq.Again):
            multipart.receive(other, zmq.NOBLOCK)


def test_a_loop_that_was_closed_may_be_stopped_and_writes_to_nobody_elses_descriptor():
    """Another thread may close it between the request to stop and the wake-up: `stop()` raised EBADF then."""
    loop = Loop()
    loop.close()
    others = [os.eventfd(0, os.EFD_NONBLOCK) for _ in range(3)]  # which have its descriptors' numbers
    try:
        loop.stop()
        loop.call_threadsafe(lambda: None)
        loop.close()
        for other in others:
            with pytest.raises(BlockingIOError):
                os.eventfd_read(other)
    finally:
        for other in others:
            os.close(other)

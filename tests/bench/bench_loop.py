# SPDX-License-Identifier: Apache-2.0
"""Our event loop beside asyncio's: a round trip of 64 bytes to a process that answers at once.

    python tests/bench/bench_loop.py

Batches of the contestants take turns, so that what else the machine does meets all of them. Figures of one
run are in docs/decisions/own-event-loop.md.
"""

from __future__ import annotations

import asyncio
import os
import socket
import statistics
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import zmq
import zmq.asyncio

from cm.loop import Loop
from cm.server.sockets import Loop as DaemonLoop
from cm.wire import multipart

TRIPS, ROUNDS = 200, 100
DATA = bytes(64)


def ours(end: socket.socket, _: str) -> None:
    loop = Loop()
    loop.add(end.fileno(), lambda: end.send(end.recv(64)))
    loop.run()


def asyncio_reader(end: socket.socket, _: str) -> None:
    async def serve() -> None:
        asyncio.get_running_loop().add_reader(end.fileno(), lambda: end.send(end.recv(64)))
        await asyncio.Event().wait()

    asyncio.run(serve())


def ours_zmq(_: socket.socket, address: str) -> None:
    server: Any = zmq.Context().socket(zmq.ROUTER)
    server.bind(address)
    loop = DaemonLoop()
    loop.add_socket(server, lambda: loop.send(server, multipart.receive(server)), foremost=True)
    loop.run()


def asyncio_zmq(_: socket.socket, address: str) -> None:
    async def serve() -> None:
        server = zmq.asyncio.Context().socket(zmq.ROUTER)
        server.bind(address)
        while True:
            await server.send_multipart(await server.recv_multipart())

    asyncio.run(serve())


def start(server: Callable[[socket.socket, str], None], number: int) -> tuple[Any, Callable[[], object]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    address = f"ipc://@cm-bench-loop-{os.getpid()}-{number}"
    process = get_context("fork").Process(target=server, args=(far, address), daemon=True)
    process.start()
    if "zmq" not in server.__name__:
        return process, lambda: (near.send(DATA), near.recv(64))
    client: Any = zmq.Context().socket(zmq.DEALER)
    client.connect(address)
    return process, lambda: (client.send(DATA), client.recv())


def processor_us(pid: int) -> float:
    """What a process and its threads have used so far."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1000


def main() -> int:
    running = {
        server.__name__: start(server, number)
        for number, server in enumerate((ours, asyncio_reader, ours_zmq, asyncio_zmq))
    }
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in running}
    for _ in range(ROUNDS):
        for name, (process, trip) in running.items():
            used, begun = processor_us(process.pid), time.perf_counter()
            for _ in range(TRIPS):
                trip()
            passed = (time.perf_counter() - begun) * 1e6
            found[name].append((passed / TRIPS, (processor_us(process.pid) - used) / TRIPS))
    for name, batches in found.items():
        trip_us, cpu_us = (statistics.median(each) for each in zip(*batches, strict=True))
        print(f"{name:16} {trip_us:7.1f} µs a trip, {cpu_us:6.1f} µs of the answering process")
        running[name][0].kill()
    return 0


if __name__ == "__main__":
    sys.exit(main())

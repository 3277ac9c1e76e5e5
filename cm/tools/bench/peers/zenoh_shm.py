# SPDX-License-Identifier: Apache-2.0
"""zenoh with shared memory: the far end moves the bytes out of one shared buffer and into another."""

from __future__ import annotations

import queue
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh
from zenoh import shm

_SLOTS = 4
_PATIENCE = 60.0  # seconds, on a loaded machine


class _Ends:
    def __init__(self, folder: Path, listen: bool, there: str, back: str, size: int) -> None:
        zenoh.init_log_from_env_or("off")
        config = zenoh.Config()
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("transport/shared_memory/enabled", "true")
        config.insert_json5("mode", '"peer"')
        config.insert_json5(
            "listen/endpoints" if listen else "connect/endpoints", f'["unixsock-stream/{folder}/zenoh"]'
        )
        if not listen:
            config.insert_json5("listen/endpoints", "[]")
        self.session: Any = zenoh.open(config)
        self.size = size
        self._provider: Any = shm.ShmProvider.default_backend(max(size, 4096) * _SLOTS)
        self.publisher: Any = self.session.declare_publisher(
            f"cm/tools/bench/{there}", congestion_control=zenoh.CongestionControl.BLOCK
        )
        self.received: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._subscriber: Any = self.session.declare_subscriber(f"cm/tools/bench/{back}", self.received.put)

    def buffer(self) -> Any:
        return self._provider.alloc(self.size, policy=shm.BlockOn(shm.GarbageCollect()))


class ZenohNear(_Ends):
    """This end: sends a shared buffer and looks at the one that comes back, without copying either."""

    def trip(self) -> object:
        """There and back."""
        self.publisher.put(self.buffer())
        return self.received.get(timeout=_PATIENCE).payload.as_shm()

    def close(self) -> None:
        """Close the session."""
        self.session.close()


def near(folder: Path, size: int) -> ZenohNear:
    """This end; returns when the far end answers."""
    ends = ZenohNear(folder, False, "there", "back", size)
    for _ in range(100):
        ends.publisher.put(ends.buffer())
        try:
            ends.received.get(timeout=0.1)
            break
        except queue.Empty:
            continue
    while not ends.received.empty():
        ends.received.get()
    return ends


def far(folder: Path, size: int, ready: Callable[[], None]) -> None:
    """The other end."""
    ends = _Ends(folder, True, "back", "there", size)
    ready()
    while True:
        payload = ends.received.get().payload
        data = bytes(payload.as_shm() or payload.to_bytes())
        buffer = ends.buffer()
        buffer[0:size] = data
        ends.publisher.put(buffer)

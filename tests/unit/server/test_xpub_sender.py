# SPDX-License-Identifier: Apache-2.0
"""How many messages may wait for a subscriber, and what happens to further ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import zmq

from cm.schema.model import Config, Direction, Mode, Stream
from cm.server.publisher import XpubSender, mark
from cm.server.sockets import Loop

MIB = 1 << 20


def config(*shapes: tuple[int, ...], dtype: str = "uint8") -> Config:
    streams = {f"s{n}": Stream(f"s{n}", "c", Direction.S2MM, shape, dtype) for n, shape in enumerate(shapes)}
    return Config("c", "board", modes={}, streams=streams)


@pytest.mark.parametrize(
    ("configs", "limit", "expected"),
    [
        ([], 32 * MIB, 32),  # frames that no schema describes have up to 1 MiB
        ([config((480, 640))], 32 * MIB, 32),
        ([config((1080, 1920, 3))], 32 * MIB, 5),
        ([config((1080, 1920, 3)), config((4096, 4096), dtype="uint16")], 128 * MIB, 4),
        ([config((1024, 1024), dtype="complex128")], 64 * MIB, 4),
        ([config((8192, 8192))], MIB, 2),
        ([config()], 0, 2),
        ([config((1,))], 1 << 50, 1000),
    ],
)
def test_the_longest_frames_of_all_schemas_stay_within_the_limit(
    configs: Sequence[Config], limit: int, expected: int
) -> None:
    assert mark(configs, limit) == expected


def test_what_a_mode_says_of_a_stream_counts() -> None:
    small = config((16,))
    large = replace(small.streams["s0"], shape=(8 * MIB,))
    assert mark([replace(small, modes={"m": Mode("m", streams={"s0": large})})], 32 * MIB) == 4


class _Full(Loop):
    """Refuses as XPUB does with NODROP, `times` times."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self.times = times
        self.refused: list[list[bytes]] = []
        self.sent: list[list[bytes]] = []

    def send(self, socket: zmq.Socket[bytes], frames: Sequence[Any], flags: int = 0) -> None:
        if socket.nodrop and len(self.refused) < self.times:  # type: ignore[attr-defined]
            self.refused.append(list(frames))
            raise zmq.Again
        self.sent.append(list(frames))


class _Socket:
    nodrop = 1

    def setsockopt(self, option: int, value: int) -> None:
        assert option == zmq.XPUB_NODROP
        self.nodrop = value


def sender(times: int) -> tuple[XpubSender, _Full]:
    loop = _Full(times)
    return XpubSender(loop, _Socket()), loop  # type: ignore[arg-type]


def test_a_short_message_waits_for_a_queue_that_is_full_for_a_moment() -> None:
    out, loop = sender(3)
    out.send([b"status"])
    assert len(loop.refused) == 3
    assert loop.sent == [[b"status"]]


def test_a_queue_that_stays_full_is_waited_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cm.server.publisher._HOPELESS", 60.0)  # seconds, of 1
    out, loop = sender(1000)
    out.send([b"one"])
    waited = len(loop.refused)
    for _ in range(5):
        out.send([b"more"])
    assert waited > 1
    assert len(loop.refused) == waited + 5
    assert loop.sent == [[b"one"], *[[b"more"]] * 5], "the others get everything"


def test_a_frame_does_not_wait() -> None:
    out, loop = sender(1)
    assert not out.send_frame([b"cm_stream/x", b"", b"frame"])
    assert out.send_frame([b"cm_stream/x", b"", b"next"])
    assert [frames[-1] for frames in loop.sent] == [b"frame", b"next"]

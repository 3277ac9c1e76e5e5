# SPDX-License-Identifier: Apache-2.0
"""What an open stream tells of itself, over a plane and a channel that do as a test says."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from itertools import count
from types import SimpleNamespace
from typing import Any

import pytest

from cm.device import Direction as ChannelDirection
from cm.device import DmaCaps, DmaInfo, DmaType
from cm.device.data_plane import StreamSetup
from cm.errors import InvalidRequest
from cm.schema.model import Direction, Stream
from cm.server.client_process import Peer
from cm.server.streams import stream
from cm.server.streams.machine import StreamMachine
from cm.server.streams.stream import OpenStream
from cm.wire.messages.status import ErrorInfo, FrameInfo, StreamClient, StreamStatus
from cm.wire.plane_packets import Descriptor, Geometry, decode_geometry, encode_label

NOW = 10**12
CAMERA = Stream("camera", "ch0", Direction.S2MM, shape=(4, 4, 2), slots=5, limit=2.0, format="yuv422", region="prr0")
CHANNEL = DmaInfo("ch0", ChannelDirection.S2MM, DmaType.AXIDMA, DmaCaps.VIDEO, 4, 1 << 20, 1, 0)


class Bench:
    """A stream's plane and channel; `log`: what was done with them."""

    def __init__(self, wanted: Stream, channel: DmaInfo) -> None:
        self.log: list[Any] = []
        self.told: list[bytes] = []
        self.slots: list[int] = []  # that the plane was given, by their handles
        self._handles = count()
        self.geometry: Geometry | None = None
        self.counts = SimpleNamespace(
            frames=7, dropped=1, errors=2, bytes=700, error=0, asked=32, came=0, at_ns=[NOW - 2 * 10**8, NOW - 10**8],
            latency_ns=[3000, 9000, 1000],
        )  # fmt: skip
        of_client = SimpleNamespace(depth=4, held=3, frames=6, dropped=5)
        plane: Any = SimpleNamespace(
            start=self._start, counts=lambda number: self._of(number, self.counts), attach=self._attach,
            client_counts=lambda client: of_client if client == 1 else None,
            tell=lambda number, packet: self._of(number, self.told.append(packet)), add_slot=self._add_slot,
            stop=lambda number, error: self._of(number, self.log.append(f"stop {error}")),
        )  # fmt: skip
        self.dma: Any = SimpleNamespace(
            info=channel, allocate=self._allocate, close=lambda: self.log.append("close channel")
        )
        self.machine = StreamMachine(wanted.name)
        self.stream = OpenStream(plane, self.dma, wanted, self.machine)
        self.machine.open(wanted)

    def join(self, client: int, depth: int, name: str = "view") -> None:
        self.machine.join(client, depth, Peer(10 - client, name, 10 - client))
        while (step := self.machine.next()) is not None:
            self.stream.take(step)

    def _start(self, dma: Any, setup: StreamSetup) -> int:
        assert dma.info.name == "ch0"
        self.log.append(setup.length)
        return 3

    @staticmethod
    def _of(number: int, result: Any) -> Any:
        assert number == 3
        return result

    def _attach(self, client: int, number: int, depth: int, packet: bytes) -> bool:
        self.geometry = decode_geometry(packet)
        return bool(self._of(number, depth))

    def _allocate(self, length: int) -> Any:
        return SimpleNamespace(
            fd=0, handle=next(self._handles), coherent=False, length=4096, close=lambda: self.log.append("close slot")
        )

    def _add_slot(self, number: int, fd: int, handle: int) -> None:
        os.fstat(fd)
        self._of(number, self.slots.append(handle))


@pytest.fixture(autouse=True)
def _clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "time", SimpleNamespace(monotonic_ns=lambda: NOW))


def opened(wanted: Stream = CAMERA, **channel: Any) -> Bench:
    return Bench(wanted, replace(CHANNEL, **channel))


def test_an_open_stream_tells_its_settings_its_counters_and_its_clients() -> None:
    it = opened()
    state = it.stream.status()
    assert state == StreamStatus(
        "camera", "ch0", "s2mm", (4, 4, 2), "uint8", 5, open=True, frames=7, dropped=1, errors=2,
        rate=pytest.approx(10.0), latency_us=3.0, limit=2.0, exact=True, max_length=1 << 20, format="yuv422",
        slot_bytes=32,
    )  # fmt: skip
    it.join(1, 4)
    it.join(2, 4, "gone meanwhile")
    it.counts.error = errno.ETIMEDOUT
    failed = ErrorInfo("transfer_failed", "a transfer of 32 bytes failed: Connection timed out")
    told = replace(state, slots=10, clients=(StreamClient(9, "view", False, 4, 3, 6, 5),), last_error=failed)
    assert it.stream.status() == told
    assert it.stream.failure() == failed


@pytest.mark.parametrize(
    ("wanted", "channel", "exact"),
    [
        (CAMERA, {}, True), (CAMERA, {"caps": DmaCaps.RESIDUE}, False),
        (CAMERA, {"type": DmaType.VDMA}, False), (replace(CAMERA, direction=Direction.MM2S), {}, False),
    ],
)  # fmt: skip
def test_frames_have_to_be_whole_where_a_channel_cannot_tell_lengths(
    wanted: Stream, channel: dict[str, Any], exact: bool
) -> None:
    assert opened(wanted, **channel).stream.status().exact is exact


def test_a_client_is_told_the_form_of_frames_and_whose_they_are() -> None:
    it = opened(replace(CAMERA, stride=16, cyclic=True, direction=Direction.MM2S))
    it.stream.label("vision", "edges")
    it.stream.label("vision", "edges")  # is known
    assert it.told == [encode_label("camera", "vision", "edges")]
    it.join(1, 6)
    assert it.geometry == Geometry(
        4096, 32, False, True, True, 6, 16, (4, 4, 2), "uint8", "camera", "vision", "edges", "yuv422"
    )
    it = opened(replace(CAMERA, stride=8))
    it.join(1, 6)
    assert it.geometry is not None
    assert (it.geometry.stride, it.geometry.writable, it.geometry.cyclic) == (0, False, False)


def test_a_frame_that_is_not_whole_is_described_as_bytes() -> None:
    it = opened()
    it.stream.label("vision", "edges")
    whole = FrameInfo("camera", 5, 77, 32, (4, 4, 2), "uint8", "vision", "edges", generation=6, format="yuv422")
    assert it.stream.info(Descriptor(length=32, sequence=5, timestamp_ns=77), 6) == whole
    part = replace(whole, length=31, shape=(31,), generation=0, format="")
    assert it.stream.info(Descriptor(length=31, sequence=5, timestamp_ns=77)) == part
    plain = opened(replace(CAMERA, format=None))
    assert plain.stream.info(Descriptor(length=32)).format == ""
    plain.join(1, 6)
    assert plain.geometry is not None
    assert plain.geometry.format == ""
    it = opened(replace(CAMERA, shape=None, dtype="uint16", format=None), frame_length=64)
    told = it.stream.info(Descriptor(length=64))
    assert (told.shape, told.dtype, told.format) == ((64,), "uint8", "")


def test_a_stream_that_ends_stops_its_channel_before_it_closes_it() -> None:
    it = opened()
    it.join(1, 4)
    it.log.clear()
    assert it.slots == list(range(6))
    it.stream.close(5)
    assert it.log == ["stop 5", "close channel", *["close slot"] * 6]


def test_a_channel_that_cannot_be_used_as_wanted_is_closed() -> None:
    it = opened()
    it.log.clear()
    with pytest.raises(InvalidRequest, match="channel ch0 moves 1048576 at most"):
        OpenStream(SimpleNamespace(), it.dma, replace(CAMERA, shape=(1 << 10, 1 << 10, 2)), it.machine)  # type: ignore[arg-type]
    assert it.log == ["close channel"]

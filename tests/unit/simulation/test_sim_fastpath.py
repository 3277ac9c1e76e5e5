# SPDX-License-Identifier: Apache-2.0
"""A loop that only passes data on is served by a C thread, with the same effect, until something else is needed."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from sim_support import Dma, Icap, Uio

from cm.formats.bitstream.container import to_dma_words
from cm.simulation.software import Board
from cm.simulation.software.hardware.models import edge

LENGTH = 100_000
SCHEMA = """
config:
  name: loop
  type: partial
  device: xc7z020
  regions:
    prr0: {decoupler: {base_address: 0x1000, offset: 0x0, bit: 0}}
  modules:
    loopback: {region: prr0, model: default}
    edges: {region: prr0, model: edge}
  modes:
    loopback: {modules: [loopback]}
    edges: {modules: [edges]}
  streams:
    to_pl: {direction: mm2s, region: prr0, shape: [100, 1000]}
    from_pl: {direction: s2mm, region: prr0, shape: [100, 1000]}
"""


class Ends:
    """Both channels, each with a buffer of two frames."""

    def __init__(self, board: Board) -> None:
        self.source = Dma(board.root, "dev/cm_dma/to_pl")
        self.sink = Dma(board.root, "dev/cm_dma/from_pl")
        self.out, self.sent = self.source.alloc(2 * LENGTH)
        self.back, self.received = self.sink.alloc(2 * LENGTH)
        self.board = board

    def trip(self, seed: int) -> None:
        """Send a frame round the loop, and check that it comes back complete and once."""
        self.sent[:LENGTH] = np.random.default_rng(seed).integers(0, 256, LENGTH, np.uint8)
        self.sink.submit(self.back, LENGTH, cookie=seed)
        self.source.submit(self.out, LENGTH, cookie=seed)
        assert self.sink.done()[:2] == (seed, LENGTH)
        assert self.source.done()[:2] == (seed, LENGTH)
        assert np.array_equal(self.received[:LENGTH], self.sent[:LENGTH])

    def moved(self) -> tuple[int, int]:
        """How many bytes went through each channel since the board's power-up."""
        state = self.board.control.state()["channels"]
        return state["to_pl"]["bytes"], state["from_pl"]["bytes"]

    @property
    def lent(self) -> int:
        """How often the channels have been lent to the thread."""
        return self.board.control.state()["channels"]["to_pl"]["lent"]


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    schema: Path = tmp_path_factory.mktemp("loop") / "loop.yaml"
    schema.write_text(SCHEMA, encoding="utf-8")
    with Board([schema]) as board:
        yield board


@pytest.fixture
def ends(shared: Board) -> Iterator[Ends]:
    shared.control.clear()
    shared.control.reset()
    load(shared, "loopback")
    both = Ends(shared)
    yield both
    both.source.close()
    both.sink.close()
    state = shared.control.state()
    assert (state["connections"], state["buffers"], state["memory"]) == (1, 0, 0)


def load(board: Board, module: str) -> None:
    with Icap(board.root, "dev/cm_icap0") as icap:
        assert icap.load(to_dma_words(board.root / f"lib/firmware/cm/loop/{module}.bit")) == (0, 0)


def test_frames_go_round_and_the_channels_are_lent(ends: Ends) -> None:
    begun = ends.moved()
    for seed in range(200):  # more completions than a queue holds
        ends.trip(seed)
    assert ends.lent > 0
    assert [now - then for now, then in zip(ends.moved(), begun, strict=True)] == [200 * LENGTH] * 2
    before = ends.lent
    ends.trip(200)
    assert ends.lent > before, "looking at the board takes the channels back, and they are lent again"


def test_sequences_go_on_over_every_change_of_hands(ends: Ends) -> None:
    numbers = []
    for seed in range(20):
        ends.sink.submit(ends.back, LENGTH, cookie=seed)
        ends.board.control.state()
        ends.source.submit(ends.out, LENGTH)
        numbers.append(ends.sink.done()[3])
        ends.source.done()
    assert numbers == list(range(20))


def test_what_is_queued_is_seen_and_cancelled(ends: Ends) -> None:
    ends.trip(1)
    for cookie in range(5):
        ends.sink.submit(ends.back, LENGTH, cookie=cookie)
    assert ends.board.control.state()["channels"]["from_pl"]["queued"] == 5
    with pytest.raises(OSError) as caught:
        ends.sink.free(ends.back)
    assert caught.value.errno == errno.EBUSY
    ends.sink.cancel()
    assert [ends.sink.done()[4] for _ in range(5)] == [-errno.ECANCELED] * 5
    ends.trip(2)


def test_a_fault_that_is_ordered_meanwhile_happens(ends: Ends) -> None:
    ends.trip(1)
    ends.board.control.inject("dma_error", "from_pl")
    ends.sink.submit(ends.back, LENGTH)
    ends.source.submit(ends.out, LENGTH)
    assert ends.sink.done()[4] == -errno.EIO
    ends.source.done()
    ends.board.control.inject("hang", "from_pl")
    ends.sink.submit(ends.back, LENGTH)
    ends.source.submit(ends.out, LENGTH)
    assert ends.sink.quiet()
    ends.board.control.clear()
    assert ends.sink.done()[4] == ends.source.done()[4] == 0
    ends.trip(2)


def test_nothing_flows_through_a_region_that_is_cut_off(ends: Ends) -> None:
    ends.trip(1)
    with Uio(ends.board.root, "dev/uio0") as static:
        static.write(0, 1)
        ends.sink.submit(ends.back, LENGTH)
        ends.source.submit(ends.out, LENGTH)
        assert ends.sink.quiet()
        static.write(0, 0)
    assert ends.sink.done()[4] == ends.source.done()[4] == 0
    ends.trip(2)


def test_a_module_still_processes_the_data(ends: Ends) -> None:
    ends.trip(1)
    load(ends.board, "edges")
    ends.sink.submit(ends.back, LENGTH)
    ends.source.submit(ends.out, LENGTH)
    assert ends.sink.done()[4] == 0
    frame = ends.sent[:LENGTH].reshape(100, 1000)
    assert np.array_equal(ends.received[:LENGTH].reshape(100, 1000), edge(frame, {}))


def test_lines_and_cycles_among_plain_frames(ends: Ends) -> None:
    ends.trip(1)
    ends.sink.submit_video(ends.back, 10, 1000, 2000)
    ends.source.submit(ends.out, 10_000)
    assert ends.sink.done()[1] == 10_000
    ends.source.done()
    assert np.array_equal(ends.received[2000:3000], ends.sent[1000:2000])
    ends.trip(2)
    ends.source.submit(ends.out, LENGTH, period=LENGTH // 2)
    ends.sink.submit(ends.back, LENGTH)
    assert ends.sink.done()[1] == LENGTH // 2
    ends.source.cancel()
    while ends.source.done()[4] != -errno.ECANCELED:
        pass
    ends.trip(3)


def test_the_fast_path_refuses_the_same_requests(ends: Ends) -> None:
    ends.trip(1)
    for handle, length, offset in ((99, 8, 0), (ends.out, 8, 3 * LENGTH), (ends.out, 0, 0)):
        with pytest.raises(OSError) as caught:
            ends.source.submit(handle, length, offset)
        assert caught.value.errno in (errno.ENOENT, errno.EINVAL)
    for _ in range(64):
        ends.source.submit(ends.out, 8)
    with pytest.raises(OSError) as caught:
        ends.source.submit(ends.out, 8)
    assert caught.value.errno == errno.EBUSY


def test_a_client_that_disconnects_gives_everything_back(ends: Ends) -> None:
    ends.trip(1)
    ends.sink.submit(ends.back, LENGTH)
    ends.sink.close()
    ends.sink = Dma(ends.board.root, "dev/cm_dma/from_pl")  # the first close is served first
    ends.back, ends.received = ends.sink.alloc(2 * LENGTH)
    ends.trip(2)

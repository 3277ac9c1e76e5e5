# SPDX-License-Identifier: Apache-2.0
"""Two regions on one MCDMA, run from their HDL: every client's frames come back on its own stream."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from conftest import HERE, needs, served

import cm

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
FRAMES = 6
SCHEMA = """\
project: {{name: shared, part: xc7z020clg400-1}}
regions:
  left: {{interfaces: {{s_axis: {{stream: to_left, shape: [64], engine: all}},
    m_axis: {{stream: from_left, shape: [64], engine: all}}}}}}
  right: {{interfaces: {{s_axis: {{stream: to_right, shape: [64], engine: all}},
    m_axis: {{stream: from_right, shape: [64], engine: all}}}}}}
modules:
  plain: {{top: loop, regions: [left], sources: [{loop}]}}
  inverse: {{top: loop, regions: [right], sources: [{loop}], parameters: {{INVERT: 4294967295}}}}
modes:
  both: {{modules: {{left: plain, right: inverse}}}}
"""


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[cm.Board]:
    folder = tmp_path_factory.mktemp("shared")
    schema = folder / "build.yaml"
    schema.write_text(SCHEMA.format(loop=HERE / "loop/hdl/loop.v"))
    with served(folder, schema, "shared", mode="both") as connected:
        yield connected


def frame(number: int) -> np.ndarray:
    return np.arange(number, number + 64, dtype=np.uint8)


def test_frames_of_two_regions_go_through_one_engine_and_come_back_on_their_streams(board: cm.Board) -> None:
    # Nothing is read before all is written, so that each reader has room for all: what exceeds its depth is dropped.
    with (
        board.stream("from_left", depth=FRAMES) as left,
        board.stream("from_right", depth=FRAMES) as right,
        board.writer("to_left", timeout=60) as to_left,
        board.writer("to_right", timeout=60) as to_right,
    ):
        for number in range(FRAMES):
            to_left.write(frame(number))
            to_right.write(frame(100 + number))
        got = [(left.read(timeout=60).copy(), right.read(timeout=60).copy()) for _ in range(FRAMES)]
    for number, (one, other) in enumerate(got):
        assert np.array_equal(one, frame(number))
        assert np.array_equal(other, ~frame(100 + number))

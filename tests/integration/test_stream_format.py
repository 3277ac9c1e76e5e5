# SPDX-License-Identifier: Apache-2.0
"""Pixels of a stream's `format`: what lies in memory, and what clients read and write."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager

import cm
import cm.aio
from cm.client.pixel_formats import from_rgb
from cm.errors import InvalidRequest
from cm.schema import SchemaError, dump, loads

RGB = np.array([[(1, 2, 3), (4, 5, 6)]], np.uint8)
SCHEMA = """
config:
  name: colours
  modules: [default]
  modes: {default: {modules: [default]}}
  streams:
    to: {direction: mm2s, channel: to, shape: [4, 6], format: FORMAT}
    from: {direction: s2mm, channel: from, shape: [4, 6], format: FORMAT}
"""


@pytest.fixture(scope="module", params=["rbg", "yuv422"])
def board(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[str, cm.Board, Path]]:
    """A manager whose module passes frames on, and the format of its streams."""
    folder = tmp_path_factory.mktemp("colours")
    (folder / "colours.yaml").write_text(SCHEMA.replace("FORMAT", request.param))
    manager = Manager(folder / "run", "--sim", "--config", str(folder), "--load", "colours").start()
    try:
        with manager.connected() as connected:
            connected.load("colours")
            yield request.param, connected, manager.runtime
    finally:
        manager.stop()


def picture() -> np.ndarray:
    found = np.full((4, 6, 3), (200, 60, 20), np.uint8)
    found[:, 2:] = (10, 90, 180)
    return found


def near(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and int(np.abs(one.astype(int) - other).max()) <= 3


def test_what_is_written_and_read_is_rgb_by_every_way(board: tuple[str, cm.Board, Path]) -> None:
    form, connected, _ = board
    for copy in (False, True):
        with connected.stream("from", timeout=60, copy=copy) as back:
            connected.write("to", picture())
            frame = back.read()
            assert near(frame, picture())
            assert (frame.info.shape, frame.info.format) == ((4, 6, 3), "rgb")
            with connected.writer("to", timeout=60) as out:
                out.write(picture())
                assert near(back.read(), picture())
    with connected.stream("from", timeout=60, raw=True) as back:
        connected.write("to", picture())
        assert np.array_equal(back.read(), from_rgb(picture(), form))


def test_bytes_are_written_as_they_are(board: tuple[str, cm.Board, Path]) -> None:
    form, connected, _ = board
    memory = from_rgb(picture(), form)
    with connected.stream("from", timeout=60) as back:
        connected.write("to", memory.tobytes())
        assert near(back.read(), picture())


def test_frames_of_another_size_keep_their_format_and_no_other_numbers_go(board: tuple[str, cm.Board, Path]) -> None:
    form, connected, _ = board
    size = {"rbg": 3, "yuv422": 2}[form]
    try:
        assert connected.configure_stream("to", shape=(2, 4)).shape == (2, 4, size)
        with pytest.raises(InvalidRequest, match=f"pixels of {form} are bytes"):
            connected.configure_stream("to", dtype="uint16")
    finally:
        connected.configure_stream("to", shape=(4, 6))


def test_the_twin_for_asyncio_does_the_same(board: tuple[str, cm.Board, Path]) -> None:
    async def through() -> np.ndarray:
        async with cm.aio.connect(runtime_dir=board[2]) as other, other.stream("from", timeout=60) as back:
            await other.write("to", picture())
            return np.array(await back.read())

    assert near(asyncio.run(through()), picture())


def test_a_capture_has_the_colours(board: tuple[str, cm.Board, Path], tmp_path: Path) -> None:
    from cm.cli.main import main

    _, connected, runtime = board
    done: list[int] = []
    command = ["stream", "capture", "from", str(tmp_path / "one.npy"), "--runtime-dir", str(runtime)]
    reader = threading.Thread(target=lambda: done.append(main(command)))
    reader.start()
    while reader.is_alive():
        connected.write("to", picture())
        reader.join(0.05)
    assert done == [0]
    assert near(np.load(tmp_path / "one.npy"), picture())


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("shape: [4, 5], format: yuv422", "pixels of yuv422 share their colour in pairs, and a line has 5"),
        ("shape: [4, 6, 2], format: rbg", "a pixel of rbg has 3 bytes, not 2"),
        ("dtype: uint16, shape: [4, 6], format: rgb", "pixels of rgb are bytes, not uint16"),
        ("format: rgb", "rgb is of pictures, and the frames have no rows and columns"),
        ("shape: [4, 6], format: rgb, encoding: rgb8", "format says what a pixel is"),
    ],
)
def test_frames_that_are_no_pictures_of_their_format_are_refused(wrong: str, said: str) -> None:
    text = f"config: {{name: wrong, modes: {{on: {{}}}}, streams: {{one: {{direction: s2mm, {wrong}}}}}}}"
    with pytest.raises(SchemaError, match=said):
        loads(text)


def test_a_mode_may_have_pixels_of_another_size() -> None:
    text = SCHEMA.replace("FORMAT", "rbg").replace(
        "default: {modules: [default]}", "default: {modules: [default], streams: {to: {format: yuv422}}}"
    )
    config = loads(text)
    assert config.modes["default"].streams["to"].shape == (4, 6, 2)
    assert loads(dump(config)) == replace(config, source=None, sha256_source=loads(dump(config)).sha256_source)

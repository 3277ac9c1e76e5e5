# SPDX-License-Identifier: Apache-2.0
"""A peer on eProsima Fast DDS, in C++, against the bridge: another implementation reads and writes what ours does."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, until

import cm
from cm.sim import Board as SimBoard

pytest.importorskip("cyclonedds.domain")

from dds_support import PATIENCE, Bridge, domain

pytestmark = pytest.mark.skipif(
    not Path("/usr/include/fastdds").is_dir() or shutil.which("g++") is None,
    reason="needs_fastdds: Debian's libfastrtps-dev, and g++",
)


@pytest.fixture(scope="module")
def program() -> Path:
    out = REPOSITORY / "build" / "fastdds_peer"  # as `make demo-ros` has it
    subprocess.run(
        ["make", "-s", "-C", REPOSITORY / "ros2" / "fastdds_peer", "OUT=../../build/fastdds_peer"],
        check=True,
        timeout=300,
    )
    return out / "peer"


@pytest.fixture(scope="module")
def bridge(shared: tuple[Manager, SimBoard]) -> Iterator[Bridge]:
    made = Bridge(shared[0].runtime, "--name", "fast")
    yield made
    status, said = made.stop()
    assert status == 0, said


def command(program: Path, *words: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "CM_PEER_LOOPBACK": "1"}
    return subprocess.Popen([program, str(domain()), *words], stdout=subprocess.PIPE, text=True, env=environment)


def said(process: subprocess.Popen[str]) -> str:
    told, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    return told.strip()


def pixels(path: Path) -> np.ndarray:
    """Of a PGM or PPM."""
    kind, size, _, data = path.read_bytes().split(b"\n", 3)
    width, height = map(int, size.split())
    return np.frombuffer(data, np.uint8).reshape((height, width) if kind == b"P5" else (height, width, 3))


def test_it_gets_the_status_that_was_published_before_it_came(program: Path, bridge: Bridge, board: cm.Board) -> None:
    wanted = f"{board.status.board} camera/default"  # once the bridge has heard of it
    until(lambda: said(command(program, "status", "/fast/status")) == wanted)


@pytest.mark.parametrize(("mode", "shape"), [("default", (480, 640)), ("colorise", (480, 640, 3))])
def test_it_gets_the_pictures_of_the_board(
    program: Path, bridge: Bridge, board: cm.Board, tmp_path: Path, mode: str, shape: tuple[int, ...]
) -> None:
    board.mode = mode
    told = said(command(program, "picture", "/fast/camera/image_raw", str(tmp_path / "p"), "3"))
    assert told.startswith(f"640x480 {'mono8' if len(shape) == 2 else 'rgb8'} camera ")
    seen = pixels(tmp_path / "p")
    assert seen.shape == shape
    assert seen.std() > 10  # a photograph, not one colour


def test_pictures_that_it_publishes_go_through_the_accelerator_and_come_back_as_they_were(
    program: Path, bridge: Bridge, board: cm.Board, tmp_path: Path
) -> None:
    board.mode = "loopback"
    relay = command(program, "relay", "/fast/camera/image_raw", "/fast/to_pl/write", "100000")
    try:
        said(command(program, "picture", "/fast/from_pl/image_raw", str(tmp_path / "p"), "2"))
        with board.stream("from_pl", timeout=PATIENCE) as back, board.stream("camera", timeout=PATIENCE) as camera:
            written = back.read().copy()
            assert written.shape == camera.read().shape
    finally:
        relay.kill()
        relay.communicate()
    assert pixels(tmp_path / "p").std() > 10
    assert written.std() > 10

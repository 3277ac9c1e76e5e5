# SPDX-License-Identifier: Apache-2.0
"""``cm stream capture``: all frames that came are in the files, however the capture ended."""

from __future__ import annotations

import io
import json
import resource
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager, environment, until

import cm
from cm import child
from cm.cli.main import main
from cm.cli.stream_capture import NpyFiles
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.process.control import Control


def command(manager: Manager, *arguments: str) -> list[str]:
    return child.command("cm.cli.main", "stream", "capture", *arguments, "--runtime-dir", str(manager.runtime))


def begun(board: cm.Board, path: Path) -> None:
    """Wait until frames are in a file."""
    until(lambda: path.exists() and len(_loaded(path)) > 1)


def _loaded(path: Path) -> np.ndarray:
    try:
        return np.load(path)
    except (ValueError, EOFError):  # its first frame is being written
        return np.empty(0)


def test_a_file_is_whole_after_each_frame(tmp_path: Path) -> None:
    files = NpyFiles(tmp_path / "x.npy", alone=False)
    for number in range(3):
        files.add(np.full((2, 3), number, np.uint16))
        assert (np.load(tmp_path / "x.npy")[number] == number).all()
    assert files.add(np.zeros(5, np.uint8)).startswith("frames of (5,) uint8 go on")
    files.close()
    assert (np.load(tmp_path / "x.npy").shape, np.load(tmp_path / "x-2.npy").shape) == ((3, 2, 3), (1, 5))


@pytest.fixture
def camera(shared: tuple[Manager, SimBoard]) -> Iterator[Control]:
    """The board's control, with a camera that waits: frames come when the test wants them."""
    control = shared[1].control
    control.pause("camera")
    yield control
    control.resume("camera")


def test_a_change_of_mode_within_loses_no_frame(
    board: cm.Board, manager: Manager, camera: Control, tmp_path: Path
) -> None:
    out = tmp_path / "x.npy"
    with subprocess.Popen(
        [*command(manager, "camera", str(out), "--count", "12", "--json")], stdout=subprocess.PIPE, env=environment()
    ) as capture:
        camera.step("camera", 4)
        begun(board, out)
        board.set_mode("colorise")
        camera.resume("camera")
        told = json.loads(capture.communicate(timeout=60)[0])
    assert capture.returncode == 0
    first, second = (np.load(name) for name in told["files"])
    assert (first.shape[1:], second.shape[1:]) == ((480, 640), (480, 640, 3))
    assert len(first) + len(second) == len(told["sequences"]) == 12
    assert told["remarks"] == ["frames of (480, 640, 3) uint8 go on in another file"]


def test_where_packets_are_not_of_the_streams_shape_the_sentence_says_so(
    board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    board.set_mode("colorise")  # whose frames are three times as long
    board.configure_stream("camera", shape=[480, 640])
    with board.stream("camera"):
        until(lambda: any(stream.last_error for stream in board.status.streams))
    line = ["stream", "capture", "camera", str(tmp_path / "x.npy"), "--runtime-dir", str(manager.runtime)]
    assert main(line) == 1
    assert "no frame within 5 s: a transfer of 307200 bytes failed" in capsys.readouterr().err


def test_ctrl_c_keeps_every_frame_that_came(board: cm.Board, manager: Manager, tmp_path: Path) -> None:
    out = tmp_path / "x.npy"
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's background job ignores it, and so do its children
    with subprocess.Popen(
        command(manager, "camera", str(out), "--count", "0", "--json"), stdout=subprocess.PIPE, env=environment()
    ) as capture:
        begun(board, out)
        capture.send_signal(signal.SIGINT)
        told = json.loads(capture.communicate(timeout=60)[0])
    assert capture.returncode == 130
    assert len(np.load(out)) == len(told["sequences"]) > 1


def test_a_full_disk_keeps_every_frame_that_has_room(board: cm.Board, manager: Manager, tmp_path: Path) -> None:
    out, room = tmp_path / "x.npy", 3 * 307200 + 1000

    def full() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    done = subprocess.run(
        command(manager, "camera", str(out), "--count", "9"),
        check=False, capture_output=True, text=True, env=environment(), preexec_fn=full,
    )  # fmt: skip
    assert done.returncode == 1
    assert f"3 frames of (480, 640) uint8 in {out}" in done.stderr
    assert np.load(out).shape == (3, 480, 640)
    assert out.stat().st_size == 128 + 3 * 307200


def test_frames_that_are_flat_as_the_stream_is_described_otherwise_say_so(
    board: cm.Board, manager: Manager, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = [str(tmp_path / "x.npy"), "--runtime-dir", str(manager.runtime)]
    assert main(["stream", "capture", "camera", *place]) == 0
    assert "bytes came" not in capsys.readouterr().out
    board.configure_stream("camera", dtype="float32", force=True)
    assert main(["stream", "capture", "camera", *place]) == 0
    assert "307200 bytes came, and a frame of 480x640 float32 has 1228800" in capsys.readouterr().out
    board.set_mode("edge_detection")  # with another mode the schema's dtype comes back


def test_a_frame_without_a_shape_is_not_saved_as_a_picture_one_pixel_high(
    board: cm.Board, manager: Manager, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("PIL.Image")
    board.configure_stream("camera", shape=(307200,), force=True)
    place = ["--runtime-dir", str(manager.runtime)]
    assert main(["stream", "capture", "camera", str(tmp_path / "x.png"), *place]) == 0
    assert "x.npy: flat bytes, without a shape, is not a picture" in capsys.readouterr().out
    assert not (tmp_path / "x.png").exists()
    assert np.load(tmp_path / "x.npy").shape == (307200,)
    board.set_mode("edge_detection")  # with another mode the schema's shape comes back


@pytest.mark.parametrize(("form", "frames"), [("npy", 2), ("png", 1), ("raw", 2)])
def test_frames_go_to_standard_output(board: cm.Board, manager: Manager, form: str, frames: int) -> None:
    arguments = ["camera", "-", "--format", form, "--count", str(frames)]
    done = subprocess.run(command(manager, *arguments), check=True, capture_output=True, env=environment())
    assert f"{frames} frame" in done.stderr.decode()
    if form == "raw":
        assert len(done.stdout) == frames * 307200
        return
    if form == "png":
        image = pytest.importorskip("PIL.Image")
        assert image.open(io.BytesIO(done.stdout)).size == (640, 480)
        return
    data = io.BytesIO(done.stdout)
    assert [np.load(data).shape for _ in range(frames)] == [(480, 640)] * frames


def test_a_name_without_a_format_is_refused_before_anything_is_read(
    manager: Manager, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["stream", "capture", "camera", str(tmp_path / "x.jpg"), "--runtime-dir", str(manager.runtime)]) == 1
    assert "written as .npy, .png or .raw" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["x.raw", "x.npy", "x.png"])
def test_what_a_file_held_stays_until_a_frame_comes(name: str, manager: Manager, tmp_path: Path) -> None:
    file = tmp_path / name
    file.write_bytes(b"precious")
    assert main(["stream", "capture", "camra", str(file), "--runtime-dir", str(manager.runtime)]) == 1
    assert file.read_bytes() == b"precious"

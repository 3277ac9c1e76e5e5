# SPDX-License-Identifier: Apache-2.0
"""`cm serve --sim=rtl`: a board that runs the shipped camera's Verilog, against the same models in software."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import HERE, needs

import cm
from cm import child

sys.path.append(str(HERE.parent))
from manager_process import Manager, environment, until

from cm.client.errors import RequestFailed, RequestInvalid
from cm.simulation.rtl.main import example_build, prepare
from cm.simulation.software import Control
from cm.simulation.software.hardware.camera import frame, shipped_photos
from cm.simulation.software.hardware.models import Colorise, default, edge

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(300)]
PHOTO = next(iter(shipped_photos().values()))
FOCUS = 3


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def board(runtime: Path) -> Iterator[cm.Board]:
    prepare(example_build())  # a manager that waits for a compiler looks as if it hung
    manager = Manager(runtime, "--sim=rtl", "--sim-hold", "0").start()
    try:
        with manager.connected() as connected:
            connected.load("camera")
            yield connected
    finally:
        manager.stop()


@pytest.mark.parametrize(
    ("mode", "register", "model"),
    [("default", None, default), ("edge_detection", ("threshold", 40), edge), ("colorise", ("palette", 2), Colorise())],
)
def test_every_mode_gives_the_pixels_of_the_software_model(
    board: cm.Board, mode: str, register: tuple[str, int] | None, model: object
) -> None:
    board.set_mode(mode)
    values = dict([register] if register else [])
    board.registers.write({"focus": FOCUS, **values})
    seen = frame(PHOTO, (480, 640), FOCUS, 1)
    expected = model(seen, values)  # type: ignore[operator]
    with board.stream("camera", timeout=60) as stream:
        pictures = [np.array(stream.read()) for _ in range(6)]
    assert any(np.array_equal(picture, expected) for picture in pictures), "the lens follows within a few frames"
    assert np.array_equal(pictures[-1], expected)


def test_registers_of_simulated_rtl_are_not_mapped_but_asked_for(board: cm.Board) -> None:
    """The logic has to see each access."""
    with pytest.raises(RequestInvalid, match="--sim=rtl") as told:
        board.registers.window("prr0")
    assert told.value.code == "no_window"
    assert board.registers["focus"] >= 0


def test_the_interrupt_of_a_frame_is_the_modules_own(board: cm.Board) -> None:
    board.set_mode("default")
    with board.interrupts["frame_done"].events(60.0) as told, board.stream("camera", timeout=60) as stream:
        for _ in range(3):
            stream.read()
        assert next(told).count


def test_without_a_compiler_the_software_models_serve_and_the_log_says_so(tmp_path: Path) -> None:
    manager = Manager(tmp_path, "--sim=rtl", env={**environment(), "CM_VERILATOR": "/nowhere/verilator"}).start()
    try:
        with manager.connected() as board:
            board.load("camera")
            with board.stream("camera", timeout=60) as stream:
                assert stream.read().shape == (480, 640)
    finally:
        manager.stop()
    assert b"models in software" in manager.log


def test_who_has_a_design_but_does_not_name_it_is_told_that_another_runs(
    board: cm.Board, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "build.yaml").touch()
    streams = "streams: {samples: {direction: mm2s, shape: [8]}}"
    (tmp_path / "fir.yaml").write_text(f"config: {{name: fir, modes: {{on: {{}}}}, {streams}}}\n")
    monkeypatch.chdir(tmp_path)
    command = [sys.executable, "-m", "cm", "serve", "--sim=rtl", "--config", "fir.yaml", "--runtime-dir", "run"]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 1
    assert "--sim=rtl runs the shipped camera; for the design of this folder: --build build.yaml" in ended.stderr
    assert "the design has no stream samples; it has camera (--build names another design)" in ended.stderr


def test_a_design_that_no_build_takes_is_simulated_and_the_log_says_what_a_build_refuses(tmp_path: Path) -> None:
    shutil.copytree(example_build().parent, tmp_path / "design")
    build = tmp_path / "design/build.yaml"
    build.write_text(build.read_text().replace("pmoda[0:3]", "ar[0:3]"))
    without = {**environment(), "CM_VERILATOR": "/nowhere/verilator"}  # nothing is compiled for this
    manager = Manager(tmp_path / "run", "--sim=rtl", "--build", str(build), env=without).start()
    try:
        assert b"cm build generate refuses this design, which is simulated all the same: " in manager.log
        assert b"are both on" in manager.log
        assert b"; 3 more: cm build check " in manager.log
    finally:
        manager.stop()


def test_a_record_of_the_board_is_run_again_against_its_hdl(board: cm.Board, runtime: Path, tmp_path: Path) -> None:
    """With the fault that it had: the same requests lead through the same states."""
    pytest.importorskip("mcap", reason="needs the extra [record]")
    from cm.recording.reader import Record
    from cm.tools.replay.board import bench
    from cm.tools.replay.check import check
    from cm.tools.replay.script import read_script

    board.set_mode("default")
    path = tmp_path / "rtl.mcap"
    command = child.command("cm.cli.main", "record", str(path), "--runtime-dir", str(runtime))
    with subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL) as recorder:
        until(lambda: path.exists() and path.stat().st_size > 0)
        until(lambda: any(f"pid {recorder.pid} " in client.name for client in board.clients()))
        board.registers.write({"focus": FOCUS})
        board.set_mode("edge_detection")
        Control(runtime / "board").inject("icap_crc")
        with pytest.raises(RequestFailed, match="CRC does not match"):
            board.set_mode("colorise")
        board.set_mode("colorise")
        recorder.terminate()
    script = read_script(Record(path))
    assert [(state.goal, state.error) for state in script.states] == [
        ("camera/edge_detection", ""),
        ("camera/colorise", "load_failed"),
        ("camera/colorise", ""),
    ]
    with bench(script, None, "rtl") as made:
        assert check(made, script).differences == ()

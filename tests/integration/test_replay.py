# SPDX-License-Identifier: Apache-2.0
"""Records are run again: the same states, the same failures, the same frames."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from manager_process import Manager, environment, served, until

import cm
from cm import child
from cm.cli.main import main
from cm.client.errors import RequestFailed
from cm.recording.reader import Record
from cm.simulation.software import Control
from cm.tools.replay.board import bench
from cm.tools.replay.check import check
from cm.tools.replay.player import Player
from cm.tools.replay.script import Script, read_script

pytest.importorskip("mcap", reason="needs the extra [record]")

pytestmark = [pytest.mark.networks, pytest.mark.timeout(280)]
APPLICATION = """
import cm
with cm.connect() as board, board.stream("camera", timeout=60) as frames:
    first = [frames.read().copy() for _ in range(3)]
    print([int(frame.sum()) for frame in first])
with cm.connect() as board:
    board.set_mode("edge_detection")
    for _ in range(2):
        try:
            board.set_mode("colorise")
        except Exception as error:
            print(error)
    board.set_mode("colorise")
    print(board.mode)
"""
ROUNDS = 3  # by hand it is a hundred: cm replay FILE --check --times 100


@contextlib.contextmanager
def recorded(manager: Manager, path: Path, *words: str) -> Iterator[None]:
    """All that happens within it is in the record."""
    command = child.command("cm.cli.main", "record", str(path), *words, "--runtime-dir", str(manager.runtime))
    with subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL) as process:
        try:
            with manager.connected() as board:
                until(lambda: any(f"pid {process.pid} " in client.name for client in board.clients()))
            until(lambda: path.exists() and path.stat().st_size > 0)
            yield
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def failure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record in which two loads fail, and frames come."""
    path = tmp_path_factory.mktemp("record") / "failure.mcap"
    with served() as (manager, sim), manager.connected() as board:
        board.load("camera", "default")
        with recorded(manager, path, "--streams", "camera", "--frames", "every", "3"):
            _work(board, sim.control)
    return path


def _work(board: cm.Board, control: Control) -> None:
    with board.stream("camera", timeout=10) as frames:
        for _ in range(12):
            frames.read().release()
    board.registers.write({"focus": 5})
    board.load("camera", "edge_detection")
    control.upset("prr0")
    assert board.check_region("prr0", repair=True).verdict == "good"
    for fault in ("icap_crc", "icap_hang"):
        control.inject(fault)
        with pytest.raises(RequestFailed):
            board.load("camera", "colorise")
    with pytest.raises(RequestFailed, match="nowhere"):
        board.load("camera", "nowhere")
    board.load("camera", "colorise")
    with board.lease("registers:focus"):
        pass


@pytest.fixture(scope="module")
def script(failure: Path) -> Script:
    return read_script(Record(failure))


def test_a_script_has_the_states_and_names_what_is_not_run_again(script: Script) -> None:
    assert [(state.goal, state.error, state.place) for state in script.states] == [
        ("camera/edge_detection", "", "camera/edge_detection"),
        ("camera/edge_detection", "", "camera/edge_detection"),  # an upset is repaired
        ("camera/colorise", "load_failed", "camera/edge_detection"),
        ("camera/colorise", "load_failed", "camera/edge_detection"),
        ("camera/colorise", "", "camera/colorise"),
    ]
    assert ("repair", "prr0") in script.states[1].steps
    assert ("load", "prr0") in script.states[2].steps
    left = "\n".join(script.left_out)
    for request in ("TakeLease", "ReleaseLease"):
        assert f"{request} of " in left
    assert "ids of leases are not in a record" in left
    assert script.streams == {"camera"}


def test_the_same_requests_lead_through_the_same_states(script: Script) -> None:
    for _ in range(ROUNDS):
        with bench(script) as made:
            found = check(made, script)
        assert found.differences == ()
        assert found.states == script.states


def test_a_run_that_differs_is_told(script: Script) -> None:
    with bench(script) as made:
        made.control.inject("icap_crc")  # what the record has not seen
        found = check(made, script)
    assert found.differences
    assert found.differences[0].startswith("state 1: the record has camera/edge_detection done")
    assert "and now it is camera/edge_detection failed (" in found.differences[0]


def test_an_application_meets_the_failure_and_the_frames_of_the_record(failure: Path, script: Script) -> None:
    kept = [event.value for event in Record(failure).events(lambda topic: topic == "cm_stream/camera")]
    assert len(kept) >= 3
    with bench(script) as made:
        player = Player(made, script, lambda _: True)

        def play() -> None:
            player.wait_for_application()
            player.play(0, 1 << 63, speed=1.0)

        playing = threading.Thread(target=play)
        playing.start()
        said = _application(made.folder, APPLICATION)
        player.stop()
        playing.join()
    sums, *errors, mode = said.splitlines()
    assert json.loads(sums) == [int(np.frombuffer(data, np.uint8).sum()) for data in kept[:3]]
    assert ["CRC does not match" in errors[0], "did not finish" in errors[1], mode] == [True, True, "colorise"]
    assert player.counts["frames"] >= 3


def _application(folder: Path, text: str) -> str:
    """What a program of somebody's says, which knows nothing of records."""
    made = subprocess.run(
        [sys.executable, "-c", text], env={**environment(), "CM_RUNTIME_DIR": str(folder)}, text=True,
        capture_output=True, timeout=200, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return made.stdout


def test_the_command_says_how_many_runs_were_alike(failure: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(failure), "--check", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["times"], told["alike"], len(told["states"])) == (1, 1, 5)


def test_the_record_says_why_as_the_manager_did(failure: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["why", "prr0", str(failure)]) == 0
    said = capsys.readouterr().out
    assert "prr0 holds colorise since" in said
    assert "the load took" in said
    assert "asked for by" in said


def test_a_time_that_is_none_is_refused(failure: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(failure), "--from", "noon"]) == 1
    assert "'noon' is no time in a record" in capsys.readouterr().err

# SPDX-License-Identifier: Apache-2.0
"""What users expect of a command line: help by name, changes that can be cancelled, registers to watch."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pytest
from manager_process import Manager, environment, served, stalled, until
from manager_schemas import written

import cm
from cm.cli.main import main
from cm.simulation.software import Board as SimBoard


@contextmanager
def told(manager: Manager, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A `cm` that runs on; its lines come as they are printed."""
    command = [sys.executable, "-m", "cm", *arguments, "--runtime-dir", str(manager.runtime)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment()) as process:
        yield process
        process.terminate()


def lines(process: subprocess.Popen[str], count: int) -> list[str]:
    stdout: IO[str] = process.stdout  # type: ignore[assignment]
    return [stdout.readline().strip() for _ in range(count)]


def test_a_change_that_runs_is_cancelled_and_the_board_is_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its first load continues once the manager has the cancel; there is no second load."""
    written(tmp_path, ("duo",))
    with served(schemas=tmp_path) as (manager, sim), manager.connected() as board:
        place = ["--runtime-dir", str(manager.runtime)]
        assert main(["cancel", *place]) == 0
        assert capsys.readouterr().out == "no change is running; nothing is loaded\n"
        board.load("duo", "default")
        cancel = cm.Board.cancel
        monkeypatch.setattr(cm.Board, "cancel", lambda asking: (cancel(asking), sim.control.clear("icap_stall")))
        with stalled(sim):
            change = board.load_async("duo", "both")
            until(lambda: (p := board.status.progress) is not None and p.step == "load")
            assert main(["cancel", "--json", *place]) == 0
        said = {"change": change.number, "cancelled": True, "config_name": "duo", "mode": "default"}
        assert json.loads(capsys.readouterr().out) == said
        assert main(["cancel", *place]) == 0
        assert capsys.readouterr().out == "no change is running; the board is in duo/default\n"


@pytest.fixture
def interrupted(tmp_path: Path) -> Iterator[Callable[..., tuple[int, Manager]]]:
    """Run `cm`, with Ctrl-C while the port holds up its change. The exit status."""
    written(tmp_path, ("duo",))
    with served(schemas=tmp_path) as (manager, sim), manager.connected() as board:
        board.load("duo", "default")
        # Under nohup(1), or in a shell's background, Ctrl-C is ignored from the start.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)

        def ctrl_c() -> None:
            until(lambda: (p := board.status.progress) is not None and p.step == "load")
            os.kill(os.getpid(), signal.SIGINT)

        def run(*words: str) -> tuple[int, Manager]:
            presser = threading.Thread(target=ctrl_c)
            with stalled(sim):
                presser.start()
                status = main([*words, "--runtime-dir", str(manager.runtime)])
                presser.join()
            return status, manager

        yield run
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("words", [("mode", "both"), ("load", "duo/both")], ids=" ".join)
def test_ctrl_c_leaves_a_change_running_and_says_how_to_take_it_back(
    words: tuple[str, ...],
    interrupted: Callable[..., tuple[int, Manager]],
    capsys: pytest.CaptureFixture[str],
) -> None:
    status, manager = interrupted(*words)
    assert status == 130
    said = "cm: the change to duo/both goes on; `cm cancel` takes it back, `cm watch` shows it\n"
    assert capsys.readouterr() == ("", said)
    with manager.connected() as board:
        until(lambda: board.status.mode == "both")


def group_interrupted(arguments: list[str], words: str, folder: Path) -> tuple[int, str]:
    """Ctrl-C on a terminal, once a command has said `words`: to it, and to all that it has started. What it said."""
    command = [sys.executable, "-c", _FROM_A_TERMINAL, *arguments]
    env = {**environment(), "CM_RUNTIME_DIR": str(folder)}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env, start_new_session=True) as process:
        assert process.stderr is not None
        said = ""
        while words not in said:
            said += (line := process.stderr.readline())
            assert line, said
        os.killpg(process.pid, signal.SIGINT)
        said += process.stderr.read()
    return process.returncode, said


_FROM_A_TERMINAL = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); from cm.cli.main import main;"
    "sys.exit(main(sys.argv[1:]))"
)


def test_ctrl_c_ends_a_manager_and_its_simulated_board_without_a_further_line(tmp_path: Path) -> None:
    arguments = ["serve", "--sim", "--state-dir", str(tmp_path / "state")]
    for _ in range(2):  # and what the board before it held is no news
        status, said = group_interrupted(arguments, "ready at", tmp_path)
        assert (status, said.count("\n")) == (0, 1), said


def test_ctrl_c_ends_a_bench_and_what_it_measures_without_a_further_line(tmp_path: Path) -> None:
    status, said = group_interrupted(["bench", "--quick", "control_vs_zmq"], "control …", tmp_path)
    assert (status, said) == (130, "cm bench: control …\n")


@pytest.mark.parametrize(
    ("line", "reached"),
    [
        ("load camera/edge_detection", "edge_detection"),
        ("load camera colorise", "colorise"),
        ("load loopback", "loopback"),
        ("load camera", "default"),
        ("mode camera/colorise", "colorise"),
        ("mode loopback", "loopback"),
    ],
)
def test_a_mode_is_named_as_status_prints_it(
    line: str, reached: str, board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*line.split(), "--runtime-dir", str(manager.runtime)]) == 0
    assert capsys.readouterr().out.startswith(f"camera/{reached} after")
    assert board.mode == reached


@pytest.mark.parametrize("line", ["camera/colorise", "camera colorise", "colorise"])
def test_a_plan_takes_a_mode_in_the_same_spelling(
    line: str, board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plan", *line.split(), "--json", "--runtime-dir", str(manager.runtime)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["config_name"], told["mode"]) == ("camera", "colorise")


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("mode nothing", "configuration 'camera' has no mode 'nothing'; there are colorise"),
        ("mode camera", "camera is a configuration: cm load camera [unknown_mode]"),
        ("load nothing", "no configuration 'nothing'; there are camera [unknown_config]"),
        ("load camera/nothing", "[unknown_mode]"),
        ("plan nothing", "[unknown_mode]"),
    ],
)
def test_a_mode_that_there_is_none_of_is_refused_with_what_there_is(
    line: str, error: str, board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*line.split(), "--runtime-dir", str(manager.runtime)]) == 1
    assert error in capsys.readouterr().err


@pytest.mark.parametrize("line", ["stream capture camera -", "mem read scratchpad -o -"])
def test_bytes_are_not_written_to_a_terminal(line: str, board: cm.Board, manager: Manager) -> None:
    outer, inner = pty.openpty()
    command = [sys.executable, "-m", "cm", *line.split(), "--runtime-dir", str(manager.runtime)]
    ran = subprocess.run(command, stdout=inner, stderr=subprocess.PIPE, text=True, env=environment(), check=False)
    os.close(inner)
    os.close(outer)
    assert ran.returncode == 1
    assert "bytes are not written to a terminal: name a file, or send them on with > or |" in ran.stderr


@pytest.mark.parametrize("words", [("watch",), ("reg", "watch", "focus")], ids=lambda words: words[0])
def test_a_manager_that_goes_away_is_reported_once_and_waited_for(
    own: tuple[Manager, SimBoard], words: tuple[str, ...]
) -> None:
    manager, _ = own
    command = [sys.executable, "-m", "cm", *words, "--runtime-dir", str(manager.runtime)]
    with manager.connected() as board:
        board.load("camera", "default")
        watch = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment())
        while not select.select([watch.stdout], [], [], 0.05)[0]:  # until it listens
            board.registers["focus"] = 3
    with watch:
        assert watch.stderr is not None
        manager.kill()
        assert watch.stderr.readline() == "cm: the manager does not answer; waiting for it\n"
        manager.start()
        assert watch.stderr.readline() == "cm: the manager answers again\n"
        watch.terminate()
        watch.communicate(timeout=60)


def test_writes_of_registers_are_watched_by_name(board: cm.Board, manager: Manager) -> None:
    stop = threading.Event()

    def write() -> None:  # the test cannot see when the watch listens
        value = 0
        with manager.connected() as other:
            while not stop.wait(0.02):
                value = value % 15 + 1
                other.registers.write({"scratch": value, "focus": value})

    writer = threading.Thread(target=write)
    writer.start()
    try:
        with told(manager, "reg", "watch", "focus", "led.blink", "--count", "2") as watch:
            first, second = lines(watch, 2)
            assert watch.wait(60) == 0
    finally:
        stop.set()
        writer.join()
    assert {first.split()[0], second.split()[0]} == {"focus"}
    assert int(second.split()[1]) == int(first.split()[1]) % 15 + 1


def test_registers_are_polled_at_an_interval(board: cm.Board, manager: Manager) -> None:
    scratch = board.registers["scratch"]
    with told(manager, "reg", "watch", "scratch", "focus", "--every", "0.01", "--json") as watch:
        seen = [json.loads(line) for line in lines(watch, 2)]
        assert seen == [{"name": "scratch", "value": scratch}, {"name": "focus", "value": 1}]
        board.registers["focus"] = 7
        assert json.loads(lines(watch, 1)[0]) == {"name": "focus", "value": 7}


def test_a_register_that_the_mode_does_not_have_is_not_watched(
    board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reg", "watch", "focsu", "--runtime-dir", str(manager.runtime)]) == 1
    assert "no register 'focsu' in this mode; did you mean 'focus'?" in capsys.readouterr().err


def test_doctor_begins_with_the_board_and_who_manages_it(
    board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    root = next(path for path in (manager.runtime / "board", *_roots(manager)) if path.exists())
    assert main(["doctor", "--root", str(root), "--runtime-dir", str(manager.runtime)]) == 0
    first, second, *rest = capsys.readouterr().out.splitlines()
    assert first.split() == ["ok", "board", "board", "a", "simulated", "board"]
    assert second.split()[:3] == ["ok", "manager", "manager"]
    packages = next(at for at, line in enumerate(rest) if " package " in line)
    assert any(" icap " in line for line in rest[:packages])


def test_a_board_in_no_mode_is_not_told_as_one_that_is_well(
    board: cm.Board, shared: tuple[Manager, SimBoard], capsys: pytest.CaptureFixture[str]
) -> None:
    manager, sim = shared
    there = ("--runtime-dir", str(manager.runtime))
    board.mode = "default"
    sim.control.inject("icap_crc", count=0)
    try:
        assert main(["mode", "edge_detection", *there]) == 1
        assert main(["doctor", *there, "--root", str(sim.root)]) == 0
        told = next(line for line in capsys.readouterr().out.splitlines() if " manager " in line)
        assert told.startswith("wrong ")
        assert ", camera, in no mode: load edge into prr0" in told
        assert main(["status", *there]) == 0
        assert "camera, in no mode   error" in capsys.readouterr().out
        with pytest.raises(cm.CmError, match="no stream 'camera' while camera is in no mode"):
            board.stream("camera").read()
    finally:
        sim.control.clear()
        board.mode = "default"
    assert main(["doctor", *there, "--root", str(sim.root)]) == 0
    assert "camera/default" in capsys.readouterr().out


def test_registers_are_read_with_their_fields_and_the_names_of_values(
    manager: Manager, board: cm.Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.registers.write({"led.pattern": 5, "led.blink": "fast"})
    there = ["--runtime-dir", str(manager.runtime)]
    assert main(["reg", "read", "led", *there]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows == [
        ["NAME", "VALUE", "HEX", "MEANS"],
        ["led", "37", "0x25"],
        [".pattern", "5", "0x5"],
        [".blink", "2", "0x2", "fast"],
    ]
    assert main(["reg", "read", "led.blink", *there]) == 0
    assert capsys.readouterr().out.splitlines()[1].split() == ["led.blink", "2", "0x2", "fast"]


def test_a_configuration_is_shown_and_its_schema_as_it_was_given(
    manager: Manager, board: cm.Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.load("camera", "default")
    there = ["--runtime-dir", str(manager.runtime)]
    assert main(["config", "show", "camera", *there]) == 0
    out = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert out[0][0] == "camera"
    assert {tuple(row[:2]) for row in out} >= {("mode", "edge_detection"), ("register", "led"), ("stream", "camera")}
    assert main(["config", "show", "--yaml", *there]) == 0
    assert "name: camera" in capsys.readouterr().out


def test_what_is_sent_without_a_file_that_nobody_has_is_said(
    manager: Manager, board: cm.Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "b.yaml").write_text(
        "config: {name: b, device: xc7z020, type: partial, modules: {one: {bitstream: one.bit}}, "
        "modes: {m: {modules: [one]}, n: {modules: [one]}}}\n"
    )
    assert main(["config", "send", str(tmp_path / "b.yaml"), "--runtime-dir", str(manager.runtime)]) == 0
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith(
        "cm config: note: configuration b: module one of region prr0 (key bitstream): no file one.bit: put it into "
    )
    board.remove_config("b")


def test_interrupts_of_several_names_are_watched_in_a_form_of_ones_own(manager: Manager, board: cm.Board) -> None:
    board.load("camera", "edge_detection")
    watch = ["irq", "watch", "frame_done", "--count", "2", "--format", "%l=%n at %S %U 100%%"]
    with board.stream("camera", timeout=60), told(manager, *watch) as process:
        first, second = lines(process, 2)
        assert process.wait(60) == 0
    found = re.fullmatch(r"frame_done=(\d+) at \d+\.\d{9} 20\d\d-\d\d-\d\dT[\d:.]+Z 100%", first)
    assert found, first
    assert second.startswith(f"frame_done={int(found[1]) + 1} at ")


def test_doctor_does_not_say_start_one_of_a_manager_that_hangs(
    manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    os.kill(manager.pid, signal.SIGSTOP)
    try:
        assert main(["doctor", "--json", "--runtime-dir", str(manager.runtime)]) == 0
    finally:
        os.kill(manager.pid, signal.SIGCONT)
    (found,) = (f for f in json.loads(capsys.readouterr().out)["findings"] if f["kind"] == "manager")
    assert found["state"] == "wrong"
    assert "no answer from a configuration manager" in found["detail"]


def _roots(manager: Manager) -> list[Path]:
    arguments = list(manager.arguments)
    return [Path(arguments[arguments.index("--root") + 1])] if "--root" in arguments else []


def test_a_second_manager_of_one_folder_learns_which_option_helps(
    manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--sim", "--runtime-dir", str(manager.runtime)]) == 1
    said = capsys.readouterr().err
    assert f"serves {manager.runtime} already; stop it, or choose another --runtime-dir" in said
    assert "--root" not in said


def test_status_waits_for_a_manager_that_starts(
    manager: Manager, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["status", "--wait", "--runtime-dir", str(manager.runtime)]) == 0
    assert main(["status", "--wait", "0", "--runtime-dir", str(tmp_path)]) == 1
    assert "no configuration manager serves" in capsys.readouterr().err


def test_the_simulated_board_of_this_machines_manager_is_found(
    runtime: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("CM_ROOT", raising=False)
    monkeypatch.setenv("CM_RUNTIME_DIR", str(runtime / "run"))
    manager = Manager(runtime / "run", "--sim").start()
    try:
        assert main(["sim", "state"]) == 0
        assert "regions" in json.loads(capsys.readouterr().out)
    finally:
        manager.stop()
    assert main(["sim", "state"]) == 1
    assert f"no simulated board in {runtime / 'run'}/board: is `cm serve --sim` running?" in capsys.readouterr().err


def test_what_a_manager_finds_out_at_its_start_is_logged_once() -> None:
    with served() as (manager, sim):
        with manager.connected() as board:
            board.load("camera", "default")
        assert manager.stop() == 0
        (sim.root / "proc/sys/kernel/random/boot_id").write_text("of another start")
        manager.start()
        assert manager.stop() == 0
    assert manager.log.count(b"what it held (camera/default) is gone") == 1

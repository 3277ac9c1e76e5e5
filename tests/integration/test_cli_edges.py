# SPDX-License-Identifier: Apache-2.0
"""The command at its edges: numbers that are none, readers that go away, disks that are full."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import Manager, environment

import cm
from cm.cli.main import main
from cm.simulation.software import Board as SimBoard

PROGRAM = f"{sys.executable} -m cm"


def shell(line: str, manager: Manager | None = None) -> subprocess.CompletedProcess[str]:
    env = environment() | ({"CM_RUNTIME_DIR": str(manager.runtime)} if manager else {})
    return subprocess.run(
        ["bash", "-c", f'set -o pipefail; cm() {{ {PROGRAM} "$@"; }}; {line}'],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env=env,
    )


@pytest.mark.parametrize("words", [["ls", "--timeout", "nan"], ["mode", "edge", "--phase", "soon"]], ids=" ".join)
def test_a_time_that_is_none_is_wrong_usage_for_a_fleet_too(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["fleet", *words])
    assert end.value.code == 2
    assert f"{words[-1]!r} is not a time in seconds" in capsys.readouterr().err


@pytest.mark.parametrize("timeout", ["0", "0.05"])
def test_an_interrupt_is_waited_for_no_longer_than_was_said(
    board: cm.Board, manager: Manager, timeout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    board.mode = "loopback"
    place = ["--runtime-dir", str(manager.runtime)]
    assert main(["irq", "wait", "loop_done", "--timeout", timeout, "--json", *place]) == 1
    said = json.loads(capsys.readouterr().out)["error"]
    assert (said["code"], said["message"]) == ("timeout", f"interrupt 'loop_done' did not come within {timeout} s")


def test_a_pulse_is_written_as_it_stands(board: cm.Board, manager: Manager) -> None:
    """Each write, in its order: not only the last value of a register that is named twice."""
    with board.registers.events("focus", "zoom", timeout=60) as events:
        done = shell("cm reg write focus=5 zoom=2 focus=1 --json", manager)
        assert (done.returncode, done.stderr) == (0, "")
        assert json.loads(done.stdout) == {"focus": 1, "zoom": 2}
        assert [(v.name, v.value) for v in events.next().values][-2:] == [("zoom", 2), ("focus", 1)]


@pytest.mark.parametrize("line", ["cm --help", "cm completion bash", "cm check --print-schema"])
def test_a_reader_that_has_gone_is_no_error_that_is_told(line: str) -> None:
    done = shell(f"{line} | true; exit ${{PIPESTATUS[0]}}")
    assert done.returncode in (0, 141)  # it may have read in time
    assert done.stderr == ""


@pytest.mark.parametrize(
    "line",
    [
        "watch | head -1 >/dev/null",
        "reg watch focus | true",
        "reg watch led --every 0.1 | head -1 >/dev/null",
        "irq wait frame_done | true",
    ],
)
def test_who_follows_ends_with_the_reader_though_nothing_happens(board: cm.Board, manager: Manager, line: str) -> None:
    board.mode = "default"
    done = shell(f"timeout 60 {PROGRAM} {line}", manager)
    assert (done.stderr, done.returncode) == ("", 141)


def test_a_full_disk_is_told_in_one_line(board: cm.Board, manager: Manager) -> None:
    for words in ("status", "status --json", "reg list"):
        done = shell(f"cm {words} >/dev/full", manager)
        assert done.returncode == 1, words
        assert done.stderr in (f"cm: {where}No space left on device\n" for where in ("", "standard output: ")), words


def test_a_command_without_standard_output_still_does_its_work(board: cm.Board, manager: Manager) -> None:
    done = shell("cm reg write focus=7 >&-", manager)
    assert (done.returncode, done.stderr) == (0, "")
    assert board.registers["focus"] == 7


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("stream capture camera - --count 1 >&-", 0),
        ("config check - <&-", 1),
        ("mem write scratchpad - <&-", 1),
        ("nonsense 2>&-", 2),
    ],
)
def test_what_the_shell_has_closed_is_as_what_leads_nowhere(
    board: cm.Board, manager: Manager, line: str, status: int
) -> None:
    board.mode = "default"
    done = shell(f"cm {line}", manager)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    assert "usage" not in done.stdout


@pytest.mark.parametrize(
    ("line", "file"),
    [
        ("stream capture camera x.npy", "x.npy"),
        ("stream capture camera x.png", "x.png"),
        ("stream capture camera x.raw", "x.raw"),
        ("mem read scratchpad -o x.npy", "x.npy"),
        ("region map prr0 --svg x.svg", "x.svg"),
        ("bitstream convert edge.bit x.bin", "x.bin"),
        ("keygen keys anna", "keys/server.key"),
        ("fleet keys keys router --host desk", "keys/ca.key"),
    ],
)
def test_the_file_for_which_there_is_no_room_is_named(
    board: cm.Board, shared: tuple[Manager, SimBoard], tmp_path: Path, line: str, file: str
) -> None:
    manager, sim = shared
    board.mode = "edge_detection"
    (tmp_path / "edge.bit").write_bytes((sim.root / "lib/firmware/cm/camera/edge.bit").read_bytes())
    done = shell(f"cd '{tmp_path}'; ulimit -f 0; cm {line}", manager)  # no file may have a byte
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert done.stderr.startswith(f"cm: {file}")
    assert "File too large" in done.stderr
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["edge.bit"]


def test_the_folder_for_which_there_is_no_room_is_named(shared: tuple[Manager, SimBoard], tmp_path: Path) -> None:
    (tmp_path / "edge.bit").write_bytes((shared[1].root / "lib/firmware/cm/camera/edge.bit").read_bytes())
    assert shell(f"cd '{tmp_path}'; cm build collect edge.bit --name a --target made").returncode == 0
    done = shell(f"cd '{tmp_path}'; ulimit -f 0; cm import archive made/a.tar.gz --out here")
    assert (done.returncode, done.stderr) == (1, "cm: here: File too large\n")


IMPOSSIBLE = """
mem read scratchpad --offset -4
mem read scratchpad --length -4
lease break -1
lease break 99999999999999999999999
status --connect tcp://127.0.0.1:1 --keys /bin/true
status --connect http://127.0.0.1
status --connect tcp://127.0.0.1:99999
"""


def test_what_cannot_be_asked_for_is_refused_in_one_line(
    board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    for line in IMPOSSIBLE.strip().splitlines():
        words = line.split() + ([] if "--connect" in line else ["--runtime-dir", str(manager.runtime)])
        assert main(words) == 1, line
        said = capsys.readouterr().err
        assert (said[:4], said.count("\n")) == ("cm: ", 1), said
        assert main([*words, "--json"]) == 1, line
        out, err = capsys.readouterr()
        assert (set(json.loads(out)["error"]), err) == ({"code", "message"}, ""), line
    done = shell("cm load $'\\xff'", manager)  # which is no text
    assert (done.returncode, done.stderr[:4], done.stderr.count("\n")) == (1, "cm: ", 1), done.stderr


def test_a_folder_of_keys_that_is_missing_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--connect", "tcp://127.0.0.1:1", "--keys", str(tmp_path / "no.key")]) == 1
    assert f"{tmp_path}/no.key: No such file or directory" in capsys.readouterr().err

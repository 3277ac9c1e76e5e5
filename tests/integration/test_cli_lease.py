# SPDX-License-Identifier: Apache-2.0
"""``cm lease take``: what a shell script holds, others do not change meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from shutil import which

import pytest
from manager_process import REPOSITORY, Manager, environment, until

import cm
from cm import child
from cm.cli.main import main
from cm.client.errors import RequestBusy

SETPRIV = ["setpriv", "--pdeathsig", "TERM"]
AS_HOLDER_AND_AS_ANOTHER = """
import os, sys
from cm.cli.main import main
mine = main(["reg", "write", "focus=3", "--runtime-dir", sys.argv[1]])
del os.environ["CM_LEASE"]
sys.exit(40 + 10 * mine + main(["reg", "write", "focus=4", "--runtime-dir", sys.argv[1]]))
"""


@pytest.fixture(autouse=True)
def _ours_is_no_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CM_LEASE", raising=False)


def test_a_command_runs_under_a_lease_that_keeps_others_out_and_ends_with_it(
    board: cm.Board, manager: Manager, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    monkeypatch.setenv("LOGNAME", "night")
    place = str(manager.runtime)
    program = [sys.executable, "-c", AS_HOLDER_AND_AS_ANOTHER, place]
    assert main(["lease", "take", "registers:focus", "--runtime-dir", place, "--", *program]) == 41
    assert "registers:focus is held by night" in capfd.readouterr().err
    assert board.registers["focus"] == 3
    assert not board.status.leases


def test_a_lease_for_a_time_outlives_the_command_and_is_given_back_by_its_id(
    board: cm.Board, manager: Manager, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ["--runtime-dir", str(manager.runtime)]
    assert main(["lease", "take", "board", "--seconds", "600", *place]) == 0
    monkeypatch.setenv("CM_LEASE", capsys.readouterr().out.strip())
    with pytest.raises(RequestBusy):
        board.registers["focus"] = 2
    assert main(["reg", "write", "focus=5", *place]) == 0
    assert main(["mode", "edge_detection", *place]) == 0
    assert main(["lease", "give", *place]) == 0
    assert capsys.readouterr().out.endswith("board is given back\n")
    board.registers["focus"] = 2
    assert main(["lease", "give", *place]) == 1
    assert "it may have ended after its time" in capsys.readouterr().err


def test_without_a_command_it_is_held_until_ctrl_c(board: cm.Board, manager: Manager) -> None:
    # whatever started the tests may have had it ignored, as a shell does for what runs in the background
    start = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\nfrom cm.cli.main import main\n"
    )
    words = ["lease", "take", "region:prr0", "--runtime-dir", str(manager.runtime)]
    command = [sys.executable, "-c", f"{start}sys.exit(main({words!r}))"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment()) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline().endswith(" holds region:prr0 until Ctrl-C\n")
        assert [lease.scope for lease in board.status.leases] == ["region:prr0"]
        holder.send_signal(signal.SIGINT)
        assert holder.wait(60) == 130
    until(lambda: not board.status.leases)


def test_a_command_that_does_not_exist_holds_nothing(
    board: cm.Board, manager: Manager, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["lease", "take", "board", "--runtime-dir", str(manager.runtime), "--", "no-such-command"]) == 1
    assert "no command 'no-such-command'" in capsys.readouterr().err
    assert not board.status.leases


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGTERM, []),
        (signal.SIGHUP, []),
        pytest.param(signal.SIGKILL, SETPRIV, marks=pytest.mark.skipif(not which("setpriv"), reason="needs setpriv")),
    ],
)
def test_what_ends_the_holder_ends_the_command(
    board: cm.Board, manager: Manager, tmp_path: Path, number: int, words: list[str]
) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored, and by children too
    place = ["--runtime-dir", str(manager.runtime)]
    ends = tmp_path / "ends"  # its reader learns when the command, which holds the other end, has ended
    os.mkfifo(ends)
    program = [*words, "sh", "-c", f"exec sleep 600 > '{ends}'"]
    command = child.command("cm", "lease", "take", "board", *place, "--", *program)
    with subprocess.Popen(command, env=environment()) as holder, ends.open("rb") as left:
        assert [lease.scope for lease in board.status.leases] == ["board"]
        holder.send_signal(number)
        assert left.read() == b""
    signal.signal(signal.SIGHUP, before)
    assert holder.returncode == (-number if words else 128 + number)
    until(lambda: not board.status.leases)

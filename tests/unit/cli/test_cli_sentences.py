# SPDX-License-Identifier: Apache-2.0
"""What a mistake on the command line is answered with: what was wrong, and what would be right."""

from __future__ import annotations

import argparse
import errno
import os
import subprocess
from pathlib import Path

import pytest
import zmq
from manager_process import short_folder

import cm.aio
import cm.fleet
from cm import child
from cm.cli.connection import connected
from cm.cli.main import main
from cm.client.errors import NoAnswer
from cm.home import cache_home, state_home
from cm.simulation.software.errors import SimError
from cm.simulation.software.transport.root import Root


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a refused command prints on stderr."""
    assert main(words) == 1
    return capsys.readouterr().err


def test_a_leading_zero_is_not_taken_for_the_name_of_a_value(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["reg", "write", "focus=010"])
    assert end.value.code == 2
    assert "010 is ambiguous: focus=10, or 0o… for octal" in capsys.readouterr().err


def test_what_is_wrong_with_a_schema_is_said_once_where_a_board_is_simulated_with_it(tmp_path: Path) -> None:
    (tmp_path / "bad.yaml").write_text("config: {name: c, modes: {m: {}}, devise: x}\n")
    command = child.command("cm", "serve", "--sim", "--config", str(tmp_path), "--runtime-dir", str(tmp_path / "run"))
    done = subprocess.run(command, env=child.environment(), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("devise")) == (1, 2)  # the key, and the word that is not known
    assert done.stderr.count("\n") == 1


def test_a_file_that_is_no_archive_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.tar.gz").write_text("no archive\n" * 200)
    told = said(capsys, "import", "archive", str(tmp_path / "x.tar.gz"), "--out", str(tmp_path / "out"))
    assert "x.tar.gz: no whole tar archive (" in told
    assert told.endswith(" [import_refused]\n")
    assert told.count("\n") == 1


def test_a_configuration_without_earlier_versions_is_no_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = said(capsys, "config", "rollback", "vision", "--out", str(tmp_path))
    assert told == f"cm: no earlier version of configuration vision in {tmp_path} [no_such_version]\n"
    assert "no earlier version 7 of configuration vision" in said(
        capsys, "config", "rollback", "vision", "--to", "7", "--out", str(tmp_path)
    )


def test_a_silent_folder_is_not_put_down_to_a_host_that_was_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CM_CONNECT", "tcp://nohost.invalid:5555")
    with short_folder() as folder, zmq.Context() as context, context.socket(zmq.ROUTER) as silent:
        silent.bind(f"ipc://{folder}/req")
        asked = argparse.Namespace(connect=None, runtime_dir=folder, keys=None)
        with pytest.raises(NoAnswer) as refused:
            connected(asked, timeout=0.1).status  # noqa: B018 - it is asked for
    assert str(refused.value).endswith("within 0.1 s")


@pytest.mark.parametrize("words", [["build", "check"], ["bitstream", "inspect", "a.bit"], ["keygen", "keys"]])
def test_a_folder_that_is_gone_is_not_put_down_to_a_file_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert said(capsys, *words) == "cm: the folder in which this was called is gone: cd to one that is there\n"


def test_a_user_without_an_account_and_a_home_ends_in_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """As ``docker run --user 4242`` has it."""

    def nobody(number: int) -> None:
        raise KeyError(f"getpwuid(): uid not found: {number}")

    monkeypatch.setattr("pwd.getpwuid", nobody)
    for name in ("HOME", "LOGNAME", "USER", "LNAME", "USERNAME", "XDG_CACHE_HOME", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    assert (cache_home(), state_home()) == (Path("/.cache"), Path("/.local/state"))
    assert cm.fleet.aio.connect("tcp/fleet.lan:7447").caller == f"uid-{os.getuid()}"


def test_a_runtime_folder_that_is_too_long_is_refused_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = ["--runtime-dir", str(tmp_path / ("x" * 99) / "run"), "--state-dir", str(tmp_path / "state")]
    assert "is too long for a socket" in said(capsys, "serve", "--sim", *folders)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--state-dir", "--runtime-dir"])
@pytest.mark.parametrize("board", [[], ["--sim"]], ids=["a board", "a simulated board"])
def test_a_file_in_the_place_of_a_folder_is_called_a_file(tmp_path: Path, option: str, board: list[str]) -> None:
    (tmp_path / "f").write_text("precious")
    folders = {"--state-dir": "state", "--runtime-dir": "run"} | {option: "f"}
    words = [word for name, folder in folders.items() for word in (name, str(tmp_path / folder))]
    command = child.command("cm", "serve", *board, "--root", str(tmp_path / "board"), *words)
    (tmp_path / "board").mkdir()
    done = subprocess.run(command, env=child.environment(), capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert f"{tmp_path / 'f'} is a file, not a folder: name a folder" in done.stderr
    assert (tmp_path / "f").read_text() == "precious"


def test_a_command_without_its_action_is_answered_with_those_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["reg"])
    assert end.value.code == 2
    assert "what is to be done? cm reg list|read|write|watch" in capsys.readouterr().err


def test_a_simulators_full_disk_is_told_as_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Root, "_create", full)
    with pytest.raises(SimError, match=r"^the root in memory cannot be used: No space .*; free some space there"):
        Root(None)
    with pytest.raises(SimError, match=f"^the root {tmp_path} cannot be used"):
        Root(tmp_path)

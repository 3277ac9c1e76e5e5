# SPDX-License-Identifier: Apache-2.0
"""Numbers on the command line that cannot be meant are refused as wrong usage, before a manager is asked."""

from __future__ import annotations

from pathlib import Path

import pytest

from cm.cli.main import main

WHOLE = "is not a whole number, 0 or more"
TIME = "is not a time in seconds"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("watch --count -1", WHOLE),
        ("reg watch --count -1", WHOLE),
        ("reg watch --every soon", TIME),
        ("reg watch --every 0", "a time of more than 0 is wanted"),
        ("irq wait frame_done --count -1", WHOLE),
        ("irq wait frame_done --timeout -1", TIME),
        ("irq wait frame_done --timeout nan", TIME),
        ("stream capture camera x.npy --count -1", WHOLE),
        ("stream capture camera x.npy --count 1.5", WHOLE),
        ("stream ping camera --count 0", "is not a whole number, 1 or more"),
        ("view camera --count -1", WHOLE),
        ("status --wait -1", TIME),
        ("status --wait inf", TIME),
        ("lease take board --seconds -1", TIME),
        ("lease take board --seconds 5 -- true", "is held for as long as that runs"),
        ("lease give", "which lease?"),
        ("sim inject hang camera --count -1", WHOLE),
        ("sim upset --region left --bits 0", "is not a whole number, 1 or more"),
        ("sim --hold -1", WHOLE),
        ("sim --rate nan", "is not a number, 0 or more"),
        ("sim --memory 0", "is not a whole number, 1 or more"),
        ("sim --static-identity x", "'x' is not a number such as 0xca4e0002"),
        ("serve --sim --sim-hold -1", WHOLE),
        ("serve --sim --sim-icap-rate -5", "is not a number, 0 or more"),
        ("build run -j 0", "is not a whole number, 1 or more"),
        ("build partition --seconds nan", "is not a time in seconds"),
        ("bridge ros --patience 0", "a time of more than 0 is wanted"),
        ("bridge fleet --lease nan", "is not a time of 1 s or more"),
        ("mode /edge", "'/edge' is not a name, or CONFIG/MODE"),
        ("load camera/", "'camera/' is not a name, or CONFIG/MODE"),
    ],
)
def test_what_cannot_be_meant_is_wrong_usage(
    words: str, why: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CM_LEASE", raising=False)
    monkeypatch.setenv("CM_RUNTIME_DIR", "/nonexistent")
    with pytest.raises(SystemExit) as end:
        main(words.split())
    assert end.value.code == 2
    assert why in capsys.readouterr().err


@pytest.mark.parametrize("words", [["keygen"], ["config", "check"], ["status", "--runtime-dir"], ["build", "check"]])
def test_an_unset_variable_does_not_stand_for_the_current_folder(
    words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main([*words, ""])
    assert end.value.code == 2
    assert "'' is no path" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ["mode", ""],
        ["load", ""],
        ["load", "camera", ""],
        ["plan", ""],
        ["fleet", "mode", ""],
        ["status", "--connect", ""],
    ],
)
def test_an_unset_variable_stands_for_no_mode_and_no_board(
    words: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CM_RUNTIME_DIR", "/nonexistent")
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert "'' is not a" in capsys.readouterr().err

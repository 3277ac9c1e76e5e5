# SPDX-License-Identifier: Apache-2.0
"""`cm doctor` reports what it finds, and its exit status whether that is sufficient."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cm.cli.main import main
from cm.simulation.software.process.child import Board


def doctor(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, Any]]:
    status = main(["doctor", "--json", *arguments])
    return status, json.loads(capsys.readouterr().out)


def states(found: dict[str, Any], kind: str) -> set[str]:
    return {f["state"] for f in found["findings"] if f["kind"] == kind}


@pytest.fixture(scope="module")
def board() -> Any:
    with Board() as running:
        yield running


def test_a_simulated_board_is_usable(board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = doctor(capsys, "--root", str(board.root), "--runtime-dir", str(tmp_path))
    assert status == 0
    assert found["usable"]
    assert found["simulated"]
    assert states(found, "icap") == states(found, "uio") == states(found, "dma") == {"ok"}


def test_what_a_machine_lacks_comes_with_advice_and_what_it_has_with_its_version(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import numpy

    status, found = doctor(capsys, "--root", str(tmp_path), "--runtime-dir", str(tmp_path))
    assert status == 1
    assert "no way to configure the PL" in found["problems"][0]
    assert states(found, "manager") == {"missing"}
    assert all(f["advice"] for f in found["findings"] if f["state"] == "missing")
    (package,) = (f for f in found["findings"] if f["name"] == "numpy")
    assert (package["kind"], package["detail"]) == ("package", numpy.__version__)


def test_people_get_a_verdict_in_the_last_line(
    board: Board, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--root", str(board.root), "--runtime-dir", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "usable (a simulated board)"

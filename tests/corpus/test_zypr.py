# SPDX-License-Identifier: Apache-2.0
"""The paper's authors' own project files, where a checkout of github.com/accl-kaust/zypr is given: ``ZYPR=FOLDER``."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cm.cli.main import main


@pytest.mark.skipif("ZYPR" not in os.environ, reason="ZYPR does not name a checkout of github.com/accl-kaust/zypr")
@pytest.mark.parametrize("name", ["sobel", "vadd", "vision", "vision2", "test"])
def test_a_project_file_of_theirs_needs_no_line_by_hand(name: str, tmp_path: Path) -> None:
    found = next(Path(os.environ["ZYPR"]).rglob(f"tests/demo/{name}.json"))
    schema = tmp_path / "build.yaml"
    assert main(["build", "init", "--from", "zypr", str(found), "--output", str(schema)]) == 0
    assert main(["build", "check", str(tmp_path)]) == 0
    assert main(["build", "generate", str(tmp_path), "--out", str(tmp_path / "build")]) == 0

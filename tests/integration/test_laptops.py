# SPDX-License-Identifier: Apache-2.0
"""Clients on other systems than Linux: the wheel for any system, without what macOS and Windows lack."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import REPOSITORY, served

pytestmark = pytest.mark.programs


@pytest.mark.timeout(300)
@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_a_laptop_drives_a_board_over_tcp(system: str, installed: Path, tmp_path: Path) -> None:
    with served(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as (manager, _):
        script, client = (REPOSITORY / "tests" / name for name in ("laptop.py", "laptop_client.py"))
        done = subprocess.run(
            [sys.executable, script, system, client, manager.tcp(), installed],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(installed)},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("all of it works\n")
    assert "is for the board, or another machine with Linux" in done.stderr

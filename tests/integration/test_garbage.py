# SPDX-License-Identifier: Apache-2.0
"""What is left to the collector of garbage by a manager that is ready."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from manager_process import CAMERA, environment

pytestmark = pytest.mark.soak


def test_what_a_manager_has_made_when_it_is_ready_is_never_looked_through_for_garbage(tmp_path: Path) -> None:
    """Full collections took 15 to 30 ms of its loop, the first of them when the first flood came."""
    code = (
        "import gc, sys\nfrom cm.server.server import Server\nfrom cm.cli.main import main\n"
        "Server.serve = lambda self, ready: (ready(), self._close())\n"
        "status = main(sys.argv[1:])\n"
        "print(status, gc.get_freeze_count() > 20_000, len(gc.get_objects()) < 5_000)"
    )
    words = ["serve", "--config", str(CAMERA), "--runtime-dir", str(tmp_path / "r"), "--state-dir", str(tmp_path / "s")]
    said = subprocess.run(
        [sys.executable, "-c", code, *words], env=environment(), capture_output=True, text=True, timeout=60, check=True
    )
    assert said.stdout == "0 True True\n"

# SPDX-License-Identifier: Apache-2.0
"""The cost of synchronising is measured where memory is not coherent, and said to be none where it is."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cm.simulation.software import Board

pytestmark = pytest.mark.timeout(900)
SOURCE = Path(__file__).parents[2] / "csrc/tests/sim_dma_buf.c"


def measured(board: Board, file: Path, **env: str) -> dict[str, Any]:
    """What the bench says in a process of its own on that board."""
    command = [sys.executable, "-m", "cm", "bench", "frame_sync", "--quick", "--json", str(file)]
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, "CM_ROOT": str(board.root), **env})
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))["frame_sync"]
    return found


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_memory_that_is_not_coherent_is_measured(tmp_path: Path) -> None:
    library = tmp_path / "sim_dma_buf.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-D_GNU_SOURCE", "-o", library, SOURCE, "-ldl"], check=True)
    with Board(arguments=["--non-coherent"]) as board:
        found = measured(board, tmp_path / "bench.json", LD_PRELOAD=str(library))
    assert found["missing"] is None
    assert found["value"] > 0
    assert found["baseline"] > 0


def test_coherent_memory_needs_nothing_and_is_reported(tmp_path: Path) -> None:
    with Board() as board:
        found = measured(board, tmp_path / "bench.json")
    assert found["value"] is None
    assert "is coherent" in found["missing"]

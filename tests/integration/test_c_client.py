# SPDX-License-Identifier: Apache-2.0
"""The worked client of docs/protocol.md, compiled and run."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from manager_process import REPOSITORY, Manager

import cm

pytestmark = pytest.mark.programs
NEEDED = ("libzmq", "libprotobuf-c")


def _missing() -> str:
    """What is missing to build it, empty if nothing is."""
    for tool in ("protoc-c", "pkg-config", "cc"):
        if shutil.which(tool) is None:
            return tool
    found = subprocess.run(["pkg-config", "--exists", *NEEDED], check=False)
    return "" if found.returncode == 0 else " or ".join(NEEDED)


@pytest.mark.skipif(bool(_missing()), reason=f"needs_c_client_tools: {_missing()} is not installed")
def test_the_documented_c_client_drives_the_manager(board: cm.Board, manager: Manager, tmp_path: Path) -> None:
    proto = REPOSITORY / "cm" / "wire"
    subprocess.run(["protoc-c", f"--proto_path={proto}", f"--c_out={tmp_path}", proto / "cm.proto"], check=True)
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", *NEEDED], check=True, capture_output=True, text=True
    ).stdout.split()
    sources = [REPOSITORY / "docs/examples/client.c", tmp_path / "cm.pb-c.c"]
    program = tmp_path / "client"
    subprocess.run(["cc", "-Wall", "-Werror", f"-I{tmp_path}", "-o", program, *sources, *flags], check=True)
    done = subprocess.run(
        [program, manager.runtime, "edge_detection"], check=False, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "focus = 2" in done.stdout
    assert "frame of camera: 480x640 uint8, 307200 bytes, made in edge_detection" in done.stdout
    assert board.registers["focus"] == 2

# SPDX-License-Identifier: Apache-2.0
"""A project of somebody's own, with the package as it is installed: examples/night_drive and its CI file."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import HERE, needs

REPOSITORY = HERE.parents[1]

pytestmark = [needs("verilator"), needs("g++"), pytest.mark.timeout(600)]


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    command = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", str(tmp_path)]
    subprocess.run([*command, str(REPOSITORY)], check=True, cwd=tmp_path)
    return next(tmp_path.glob("*.whl"))


def test_the_projects_ci_file_passes_outside_of_the_tree(wheel: Path, tmp_path: Path) -> None:
    project = tmp_path / "night_drive"
    shutil.copytree(REPOSITORY / "examples/night_drive", project)
    clean = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTEST_ADDOPTS")}
    environment = {**clean, "FPGA_CM": str(wheel), "VENV": str(tmp_path / "venv")}
    done = subprocess.run(
        [project / "ci.sh"], capture_output=True, text=True, env=environment, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "3 passed" in done.stdout
    inside = subprocess.run(
        [tmp_path / "venv/bin/python", "-c", "import cm; print(cm.__file__)"],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert inside.stdout.startswith(str(tmp_path / "venv"))

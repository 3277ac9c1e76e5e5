# SPDX-License-Identifier: Apache-2.0
"""A client elsewhere than on Linux: the wheel for any system, without what macOS and Windows do not have."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from manager_process import REPOSITORY, served

BUILD = "import sys; sys.path.insert(0, 'release'); import backend; print(backend.build_wheel(sys.argv[1]))"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as pip leaves it there."""
    if not (REPOSITORY / ".git").exists():
        pytest.skip("needs a git checkout: builds what is in version control")
    folder = tmp_path_factory.mktemp("any")
    names = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, check=True).stdout
    tree = folder / "tree"
    tree.mkdir()
    subprocess.run(["xargs", "-0", "cp", "--parents", "-t", tree], input=names, cwd=REPOSITORY, check=True)
    env = {**os.environ, "CM_PURE": "1", "PYTHONWARNINGS": "ignore"}
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(folder)], cwd=tree, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    wheel = folder / done.stdout.splitlines()[-1]
    assert wheel.stem.endswith("-py3-none-any")
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(".so")]
        archive.extractall(folder / "installed")
    return folder / "installed"


@pytest.mark.timeout(300)
@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_a_laptop_drives_a_board_over_tcp(system: str, installed: Path, tmp_path: Path) -> None:
    with served(arguments=("--listen", "tcp://127.0.0.1:0", "--insecure")) as (manager, _):
        address = json.loads((manager.runtime / "endpoints.json").read_text())["tcp"][0]["pub"]
        script, client = (REPOSITORY / "tests" / name for name in ("laptop.py", "laptop_client.py"))
        done = subprocess.run(
            [sys.executable, script, system, client, address, installed],
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

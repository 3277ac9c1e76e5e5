# SPDX-License-Identifier: Apache-2.0
"""What imports where something is missing; which room may import which, pyproject.toml says (`make lint`)."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "cm"

_ON_A_LAPTOP = (
    "import cm.aio, cm.client.aio.board, cm.client.board, cm.cli.status, cm.cli.reg, cm.cli.stream, cm.cli.mem\n"
)


@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_the_clients_import_where_only_linux_things_are_missing(system: str, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(_ON_A_LAPTOP)
    laptop = PACKAGE.parent / "tests/laptop.py"
    done = subprocess.run(
        [sys.executable, laptop, system, script],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)},
    )
    assert done.returncode == 0, done.stderr


_SERVES = """
import sys
from cm.cli.main import main
from cm.server.server import Server

def serve(self, ready):
    print([name for name in sys.argv[3:] if name in sys.modules])

Server.serve = serve
sys.exit(main(["serve", "--runtime-dir", sys.argv[1], "--root", sys.argv[1], "--config", sys.argv[2]]))
"""
_NOT_NEEDED = ["dataclasses", "cm.manager.interfaces", "cm.formats.signing", "cm.cli.keygen", "fastjsonschema", "numpy"]
if find_spec("_sha2") or find_spec("_sha256"):  # a Python may be built without its own SHA-256
    _NOT_NEEDED.append("hashlib")


def test_a_manager_that_starts_imports_nothing_that_only_some_need(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _SERVES, tmp_path, PACKAGE / "data/camera", *_NOT_NEEDED]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr

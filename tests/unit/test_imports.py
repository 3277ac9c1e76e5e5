# SPDX-License-Identifier: Apache-2.0
"""What imports where something is missing; which room may import which, pyproject.toml says (`make lint`)."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "cm"

_WITHOUT_SHIMS = """
import importlib, pkgutil, sys

for compiled in ("cm.device.native", "cm.device", "cm.formats.bitstream", "cffi", "zmq", "google"):
    sys.modules[compiled] = None  # importing it raises ImportError
import cm.manager

for module in pkgutil.walk_packages(cm.manager.__path__, "cm.manager."):
    importlib.import_module(module.name)
print(len([name for name in sys.modules if name.startswith("cm.manager.")]))
"""


def test_the_manager_imports_where_no_shim_was_compiled() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT_SHIMS], capture_output=True, text=True, check=False, cwd=PACKAGE.parent
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 20


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

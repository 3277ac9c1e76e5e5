# SPDX-License-Identifier: Apache-2.0
"""`make wheel` says what is missing before it builds anything."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_a_python_without_cffi_is_told_by_the_name_of_debians_package(tmp_path: Path) -> None:
    bare = tmp_path / "python3"
    bare.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')
    bare.chmod(0o755)
    code = f"import sys, wheels; wheels.PYTHON = {str(bare)!r}; sys.exit(wheels.main())"
    command = [sys.executable, "-c", code, "--out", "x", "none.tar.gz"]
    place = {"PYTHONPATH": str(ROOT / "release")}
    done = subprocess.run(command, env=place, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 1
    assert "apt install" in done.stderr
    assert "python3-cffi" in done.stderr
    assert "Traceback" not in done.stderr

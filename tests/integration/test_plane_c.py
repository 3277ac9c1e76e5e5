# SPDX-License-Identifier: Apache-2.0
"""The C client library, installed to a folder, and its documented example, compiled and run."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from manager_process import REPOSITORY, Manager

import cm

TOOLS = ("make", "cc", "pkg-config")
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs_c_tools: {', '.join(MISSING)} not installed")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, linked with the installed library."""
    prefix = tmp_path_factory.mktemp("prefix")
    build = ["make", "-C", str(REPOSITORY / "csrc" / "client"), "install", f"PREFIX={prefix}", f"BUILD={prefix}/build"]
    checks = "CFLAGS=-O1 -g -Werror -fsanitize=address,undefined -fno-sanitize-recover=all"
    subprocess.run([*build, checks], check=True, capture_output=True)
    env = {**os.environ, "PKG_CONFIG_PATH": str(prefix / "lib" / "pkgconfig")}
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "cm-plane"], check=True, capture_output=True, text=True, env=env
    ).stdout.split()
    program = prefix / "reader"
    source = REPOSITORY / "docs" / "examples" / "reader.c"
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-o", program, source, *flags]
    subprocess.run([*command, f"-Wl,-rpath,{prefix}/lib"], check=True)
    return program


def run(reader: Path, manager: Manager, stream: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [reader, manager.runtime, stream, "5"], check=False, capture_output=True, text=True, timeout=60
    )


def test_the_documented_reader_reads(board: cm.Board, manager: Manager, reader: Path) -> None:
    done = run(reader, manager, "camera")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert all("of default: 480x640 uint8, 307200 bytes, mean " in line for line in lines[:5])
    numbers = [int(line.split()[1]) for line in lines[:5]]
    assert numbers == list(range(numbers[0], numbers[0] + 5))
    assert lines[5] == "0 lost"
    means = {line.rpartition(" ")[2] for line in lines[:5]}
    with board.stream("camera") as stream:
        assert means & {f"{frame.mean():.1f}" for frame, _ in zip(stream, range(8), strict=False)}


def test_an_unknown_stream_is_refused_with_the_reason(board: cm.Board, manager: Manager, reader: Path) -> None:
    done = run(reader, manager, "camra")
    assert done.returncode == 1
    assert "unknown_stream: no stream 'camra'" in done.stderr


def test_a_folder_without_a_manager_is_an_error(reader: Path, tmp_path: Path) -> None:
    done = subprocess.run([reader, tmp_path, "camera", "1"], check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "No such file" in done.stderr

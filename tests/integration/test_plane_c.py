# SPDX-License-Identifier: Apache-2.0
"""The C client library, installed to a folder, and its documented examples, compiled and run."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager

import cm
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware import camera

TOOLS = ("make", "cc", "pkg-config")
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(bool(MISSING), reason=f"needs_c_tools: {', '.join(MISSING)} not installed"),
]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The installed library, with sanitizers."""
    prefix = tmp_path_factory.mktemp("prefix")
    build = ["make", "-C", str(REPOSITORY / "csrc" / "client"), "install", f"PREFIX={prefix}", f"BUILD={prefix}/build"]
    checks = "CFLAGS=-O1 -g -Werror -fsanitize=address,undefined -fno-sanitize-recover=all"
    subprocess.run([*build, checks], check=True, capture_output=True)
    return prefix


def compiled(prefix: Path, name: str) -> Path:
    """An example, linked with the installed library."""
    env = {**os.environ, "PKG_CONFIG_PATH": str(prefix / "lib" / "pkgconfig")}
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "cm-plane"], check=True, capture_output=True, text=True, env=env
    ).stdout.split()
    program, source = prefix / name, REPOSITORY / "docs" / "examples" / f"{name}.c"
    command = ["cc", "-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", "-o", program, source, *flags]
    subprocess.run([*command, f"-Wl,-rpath,{prefix}/lib"], check=True)
    return program


@pytest.fixture(scope="module")
def reader(installed: Path) -> Path:
    """The example that reads."""
    return compiled(installed, "reader")


@pytest.fixture(scope="module")
def writer(installed: Path) -> Path:
    """The example that writes."""
    return compiled(installed, "writer")


def run(program: Path, manager: Manager, stream: str, *more: str) -> subprocess.CompletedProcess[str]:
    command = [program, manager.runtime, stream, "5", *more]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)


def test_the_documented_reader_reads(board: cm.Board, manager: Manager, reader: Path) -> None:
    done = run(reader, manager, "camera")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert all("of default: 480x640 uint8, 307200 bytes, mean " in line for line in lines[:5])
    numbers = [int(line.split()[1].rstrip(",")) for line in lines[:5]]
    assert numbers == sorted(set(numbers))
    assert lines[5] == f"{numbers[-1] - numbers[0] - 4} lost", "what a busy machine kept from it is counted"
    pictures = {f"{camera.frame(photo).mean():.1f}" for photo in camera.shipped_photos().values()}
    assert {line.rpartition(" ")[2] for line in lines[:5]} <= pictures


def test_in_c_frames_after_a_write_are_of_its_generation(board: cm.Board, manager: Manager, reader: Path) -> None:
    with board.stream("camera", timeout=30) as stream:
        written = board.registers.write({"focus": 2})
        stream.after(written)
        lines = run(reader, manager, "camera").stdout.splitlines()
    assert {int(line.split()[3].rstrip(",")) for line in lines[:5]} == {written.generation}


def test_an_unknown_stream_is_refused_with_the_reason(board: cm.Board, manager: Manager, reader: Path) -> None:
    done = run(reader, manager, "camra")
    assert done.returncode == 1
    assert "unknown_stream: no stream 'camra'" in done.stderr


def test_a_folder_without_a_manager_is_an_error(reader: Path, tmp_path: Path) -> None:
    done = subprocess.run([reader, tmp_path, "camera", "1"], check=False, capture_output=True, text=True)
    assert done.returncode == 1
    assert "No such file" in done.stderr


# ---- writing -------------------------------------------------------------------------------


@pytest.fixture
def loop(board: cm.Board) -> Iterator[cm.Board]:
    """A loop from `to_pl` to `from_pl`."""
    board.load("camera", "loopback")
    yield board
    board.load("camera", "default")


@pytest.mark.parametrize("settings", [{}, {"shape": (48, 100), "stride": 128}, {"shape": (4096,), "dtype": "uint16"}])
def test_the_documented_writer_writes(loop: cm.Board, manager: Manager, writer: Path, settings: dict[str, Any]) -> None:
    for name in ("to_pl", "from_pl"):
        loop.configure_stream(name, **settings)
    with loop.stream("from_pl", depth=8, timeout=60) as stream:
        done = run(writer, manager, "to_pl")
        assert done.returncode == 0, done.stderr
        assert done.stdout == "5 frames taken\n"
        for number, frame in zip(range(5), stream, strict=False):
            assert (np.ascontiguousarray(frame).view(np.uint8) == number).all()


def test_a_frame_that_failed_is_reported_to_its_writer(
    loop: cm.Board, shared: tuple[Manager, SimBoard], writer: Path
) -> None:
    shared[1].control.inject("dma_error", "to_pl")
    with loop.stream("from_pl", timeout=60):
        done = run(writer, shared[0], "to_pl")
    assert done.returncode == 1
    assert "Input/output error" in done.stderr


def test_what_cannot_be_written_is_refused_with_the_reason(board: cm.Board, manager: Manager, writer: Path) -> None:
    done = run(writer, manager, "camera")
    assert done.returncode == 1
    assert "invalid_request: stream 'camera' is s2mm" in done.stderr


def test_leases_are_shown(loop: cm.Board, manager: Manager, reader: Path, writer: Path) -> None:
    loop.configure_stream("from_pl", backpressure=True)
    with manager.connected() as other, other.lease("region:prr1", holder="the other") as lease:
        for program, stream in ((reader, "from_pl"), (writer, "to_pl")):
            done = run(program, manager, stream)
            assert done.returncode == 1
            assert "held_by: " in done.stderr
            assert "the other" in done.stderr
        reading = subprocess.Popen(
            [reader, manager.runtime, "from_pl", "5", lease.id], stdout=subprocess.PIPE, text=True
        )
        done = run(writer, manager, "to_pl", lease.id)
        assert done.returncode == 0, done.stderr
        text = reading.communicate(timeout=60)[0]
    assert reading.returncode == 0
    assert [line.rpartition(" ")[2] for line in text.splitlines()[:5]] == ["0.0", "1.0", "2.0", "3.0", "4.0"]


def test_functions_of_older_versions_of_the_library_are_still_exported(installed: Path) -> None:
    """The ABI only grows, and nothing internal is exported."""
    command = ["nm", "-D", "--defined-only", installed / "lib" / "libcm_plane.so.0"]
    names = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[2::3]
    old = {"close", "error", "fd", "geometry", "lost", "mode", "next", "open", "release"}
    assert {f"cm_reader_{name}" for name in old} <= set(names)
    assert all(name.startswith(("cm_reader_", "cm_writer_")) for name in names)

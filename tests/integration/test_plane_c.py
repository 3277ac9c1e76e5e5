# SPDX-License-Identifier: Apache-2.0
"""The C client library, installed to a folder, and its documented examples, compiled and run."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manager_process import REPOSITORY, Manager, until

import cm
from cm.simulation.software import Board as SimBoard
from cm.simulation.software.hardware import camera
from cm.wire.encode import encoded
from cm.wire.messages.status import ConfigInfo, FieldInfo, RegisterInfo

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


def built(prefix: Path, folder: Path, source: str) -> Path:
    """A program of a test's own, with what is inside the library too."""
    (folder / "program.c").write_text(source)
    place = REPOSITORY / "csrc/client"
    flags = ["-Wall", "-Wextra", "-Werror", "-fsanitize=address,undefined", f"-I{place}", f"-I{REPOSITORY}/csrc"]
    command = ["cc", *flags, "-o", folder / "program", folder / "program.c", prefix / "lib/libcm_plane.a"]
    subprocess.run(command, check=True)
    return folder / "program"


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
    assert all(name.startswith(("cm_reader_", "cm_writer_", "cm_register_", "cm_registers_")) for name in names)


# ---- registers -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def registers(installed: Path) -> Path:
    """The example that maps registers."""
    return compiled(installed, "registers")


@pytest.fixture
def edge(board: cm.Board) -> cm.Board:
    """In the mode whose module has the register `threshold`, 0 to 255."""
    board.mode = "edge_detection"
    return board


def access(program: Path, manager: Manager, *words: str) -> tuple[int, str]:
    """Status, and what the program says: MODULE REGISTER VALUE COUNT."""
    command = [program, manager.runtime, *words]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("name", ["edge", "prr0"])
def test_registers_are_written_and_read(edge: cm.Board, manager: Manager, registers: Path, name: str) -> None:
    status, said = access(registers, manager, name, "threshold", "41", "1000")
    assert (status, said.partition(",")[0]) == (0, "threshold of edge is 41")
    assert edge.registers["threshold"] == 41


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("edge", "threshold", "256", "1"), "threshold: Numerical result out of range"),
        (("edge", "palette", "1", "1"), "palette: No such file or directory"),
        (("colorise", "palette", "1", "1"), "colorise: module_absent: "),
        (("nowhere", "x", "1", "1"), "nowhere: not_found: no module, region or block 'nowhere'; there are "),
    ],
)
def test_what_registers_do_not_allow(
    edge: cm.Board, manager: Manager, registers: Path, words: tuple[str, ...], said: str
) -> None:
    status, told = access(registers, manager, *words)
    assert status == 1
    assert told.startswith(f"registers: {said}")


def test_a_change_takes_registers_away_from_a_program_that_never_stops(
    edge: cm.Board, manager: Manager, registers: Path
) -> None:
    command = [registers, manager.runtime, "edge", "threshold", "7", str(10**15)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as program:
        until(lambda: [window for window in edge.status.windows if window.pid == program.pid])
        edge.mode = "colorise"
        assert program.stderr is not None
        assert program.stderr.read() == "registers: threshold: taken back, the board goes to colorise\n"
    assert program.returncode == 1


# Accesses a register of one window through another whose pages never came, and prints each errno.
EARLY = """
#include <errno.h>
#include <stdio.h>
#include "cm_registers.h"

int main(int argc, char **argv)
{
	struct cm_registers *refused = cm_registers_open(argv[1], "nowhere", CM_REGISTERS_WRITE, NULL);
	struct cm_register which = { .width = 32, .access = CM_REGISTER_READS | CM_REGISTER_WRITES, .mask = 255 };
	uint64_t value;
	int read, written;

	read = cm_register_read(refused, &which, &value) ? errno : 0;
	written = cm_register_write(refused, &which, 1) ? errno : 0;
	printf("%d %d\\n", read, written);
	cm_registers_close(refused);
	return argc != 2;
}
"""


def test_a_register_before_its_pages_are_there(
    board: cm.Board, manager: Manager, installed: Path, tmp_path: Path
) -> None:
    program = built(installed, tmp_path, EARLY)
    told = subprocess.run([program, manager.runtime], check=True, capture_output=True, text=True, timeout=60).stdout
    assert told == f"{errno.EAGAIN} {errno.EAGAIN}\n"


# Prints what a name leads to in a table from a file, or an errno; then the same for every beginning of the table.
FIND = """
#include <errno.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "cm_private.h"
#include "cm_registers.h"

int main(int argc, char **argv)
{
	static char bytes[65536];
	size_t size = fread(bytes, 1, sizeof(bytes), stdin);

	for (int i = 1; i < argc; i++) {
		struct cm_register r = { 0 };

		if (table_find(bytes, size, argv[i], &r))
			printf("%d\\n", errno);
		else
			printf("%" PRIu64 " %u %u %u %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 "\\n", r.offset, r.width,
				r.access, r.lsb, r.mask, r.kept, r.minimum, r.maximum);
		for (size_t less = 0; less < size; less++) {
			char *part = malloc(less ? less : 1); /* of just that size, for the sanitizer */

			memcpy(part, bytes, less);
			if (table_find(part, less, argv[i], &r) && errno != ENOENT && errno != EPROTO)
				abort();
			free(part);
		}
	}
	return 0;
}
"""
READS, WRITES = 1, 2
ALL32, ALL64 = (1 << 32) - 1, (1 << 64) - 1
TABLE = ConfigInfo(
    "camera",
    "partial",
    "edge",
    registers=(
        RegisterInfo("plain", 0x1000, 32, "rw", minimum=2, maximum=9, doc="a doc"),
        RegisterInfo("wide", 0x1008, 64, "ro"),
        RegisterInfo("clear", 0x1010, 32, "w1c", fields=(FieldInfo("done", 3, 1),)),
        RegisterInfo(
            "control",
            0x1014,
            16,
            "rw",
            fields=(
                FieldInfo("speed", 4, 4),
                FieldInfo("start", 0, 1, access="w1s"),
                FieldInfo("is", 8, 2, access="ro"),
            ),
        ),
        RegisterInfo("blind", 0x1018, 32, "wo", fields=(FieldInfo("low", 0, 8),)),
        RegisterInfo(
            "events", 0x101C, 32, "rw", fields=(FieldInfo("some", 0, 8), FieldInfo("gone", 8, 8, access="rc"))
        ),
    ),
)


def test_what_names_of_registers_and_fields_lead_to(installed: Path, tmp_path: Path) -> None:
    program = built(installed, tmp_path, FIND)
    names = {
        "plain": f"4096 32 {READS | WRITES} 0 {ALL32} 0 2 9",
        "wide": f"4104 64 {READS} 0 {ALL64} 0 0 {ALL64}",
        "clear": f"4112 32 {READS | WRITES} 0 {ALL32} 0 0 {ALL64}",
        "clear.done": f"4112 32 {READS | WRITES} 3 1 0 0 {ALL64}",
        "control.speed": f"4116 16 {READS | WRITES} 4 15 {0xFC0E} 0 {ALL64}",
        "control.start": f"4116 16 {READS | WRITES} 0 1 {0xFCFE} 0 {ALL64}",
        "control.is": f"4116 16 {READS} 8 3 {0xFCFE} 0 {ALL64}",
        "blind.low": f"4120 32 0 0 255 0 0 {ALL64}",
        "events.some": f"4124 32 {READS} 0 255 0 0 {ALL64}",
        "control.": str(errno.ENOENT),
        "contro": str(errno.ENOENT),
        "": str(errno.ENOENT),
    }
    asked = subprocess.run([program, *names], input=encoded(TABLE), check=True, capture_output=True)
    assert dict(zip(names, asked.stdout.decode().splitlines(), strict=True)) == names

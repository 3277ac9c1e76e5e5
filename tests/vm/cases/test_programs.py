# SPDX-License-Identifier: Apache-2.0
"""The C programs of kmod/tests, one of them written as for libaxidma, on a simulated PL of their own."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest
from served import PATIENCE, driver

from cm import device

pytestmark = pytest.mark.needs("dma", "plsim")
PROGRAMS = Path("/opt/cm/bin")
# What the programs expect to find.
CHANNELS: dict[str, plsim.Attributes] = {
    "to_pl": {"kind": "loopback", "direction": "mm2s", "peer": "from_pl"},
    "from_pl": {"kind": "loopback", "direction": "s2mm", "peer": "to_pl"},
    "camera": {},
    "display": {"kind": "sink"},
    "vcam": {"video": 1, "interval_us": 2000},
    "icap": {"kind": "icap", "idcode": "0x03727093", "timeout_ms": 600_000},
    "icap_read": {"kind": "readback", "peer": "icap"},
}
WINDOWS: dict[str, plsim.Attributes] = {"camera": {"address": "0x43c00000", "size": 8192, "doorbell": "0x1000"}}


@pytest.fixture(scope="module")
def engine() -> Iterator[Path]:
    with plsim.nothing(), plsim.board(CHANNELS, WINDOWS) as folder:
        yield folder


@contextlib.contextmanager
def axidma() -> Iterator[None]:
    """With the module that makes /dev/axidma."""
    subprocess.run(["modprobe", "cm_axidma_compat"], check=True)
    try:
        yield
    finally:
        subprocess.run(["rmmod", "cm_axidma_compat"], check=True)


@pytest.fixture
def described_engine() -> Iterator[Path]:
    """An engine whose channels a device tree gives to /dev/axidma, numbered from 16."""
    with axidma():
        device.Overlays("/").apply("axidma", plsim.overlay("axidma"))
        try:
            yield Path("/sys/kernel/debug/cm_plsim/axidma-engine")
        finally:
            device.Overlays("/").remove("axidma")


def run(program: str, engine: Path, *arguments: str) -> None:
    done = subprocess.run(
        [PROGRAMS / program, engine, *arguments], capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    wrong = [line for line in done.stdout.splitlines() if line.startswith("FAIL")]
    assert (done.returncode, wrong) == (0, []), done.stdout + done.stderr
    assert done.stdout.count("\nok ") > 10


def test_the_c_program_of_the_channels_passes(engine: Path) -> None:
    run("smoke_dma", engine)


def test_the_c_program_of_the_port_passes(engine: Path) -> None:
    run("smoke_icap", engine)


def test_a_program_written_for_libaxidma_passes(engine: Path) -> None:
    with axidma():
        run("smoke_axidma", engine)


def test_the_c_program_of_the_register_windows_passes(engine: Path) -> None:
    run("smoke_uio", engine)


def test_the_c_program_of_pages_on_loan_passes(engine: Path) -> None:
    run("smoke_window", engine)


@pytest.mark.needs("overlay")
def test_a_program_written_for_libaxidma_passes_on_channels_of_a_device_tree(described_engine: Path) -> None:
    assert driver("axidma-chrdev") == "cm_axidma_compat"
    run("smoke_axidma", described_engine, "16")


def test_what_is_live_cannot_be_changed(engine: Path) -> None:
    with pytest.raises(OSError, match="busy"):
        (plsim.ROOT / "test/dma/camera/kind").write_text("sink")
    with pytest.raises(OSError, match="busy"):
        (plsim.ROOT / "test/dma/another").mkdir()

# SPDX-License-Identifier: Apache-2.0
"""The kernel modules by themselves: KUnit suites, unloading under load, and coming back."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest
from capabilities import LOOK, kernel_log

from cm import device

UPDATES = Path("/lib/modules", os.uname().release, "updates")
SUITES = sorted(path.stem for path in UPDATES.glob("*kunit*.ko")) + sorted(p.stem for p in UPDATES.glob("*_test.ko"))
LIVE = Path("/sys/kernel/config/cm_plsim/board/live")


def modprobe(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["modprobe", *arguments], capture_output=True, text=True, check=False)


@pytest.mark.needs("kunit")
def test_there_are_kunit_suites() -> None:
    assert SUITES


@pytest.mark.needs("kunit")
@pytest.mark.parametrize("suite", SUITES)
def test_kunit_suite_passes(suite: str) -> None:
    assert modprobe("kunit", "enable=1").returncode == 0
    seen = len(kernel_log())
    assert modprobe(suite).returncode == 0
    log = kernel_log()[seen:]
    modprobe("-r", suite)
    assert re.search(r"^\S*\s*ok \d+ \S+|\] ok \d+", log, re.MULTILINE), log
    assert "not ok" not in log


@pytest.fixture
def configfs_board() -> Path:
    if LOOK["overlay"]():
        pytest.skip("this board is described by its device tree")
    return LIVE


def test_a_board_goes_away_under_an_open_channel_and_comes_back(configfs_board: Path) -> None:
    with device.AxiDma.open("from_pl") as channel, channel.allocate(4096) as target:
        channel.submit(target, length=4096)
        configfs_board.write_text("0")
        assert not Path("/dev/cm_dma/from_pl").exists()
        with pytest.raises(device.DeviceError):
            channel.submit(target, length=4096)
    configfs_board.write_text("1")
    with (
        device.AxiDma.open("to_pl") as out,
        device.AxiDma.open("from_pl") as back,
        out.allocate(64) as source,
        back.allocate(64) as target,
    ):
        back.submit(target, length=64)
        out.submit(source, length=64)
        assert (out.wait(30).status, back.wait(30).length) == (0, 64)


def test_twenty_times_there_and_gone(configfs_board: Path) -> None:
    for _ in range(20):
        configfs_board.write_text("0")
        assert device.list_dma() == []
        configfs_board.write_text("1")
        assert Path("/dev/cm_dma/camera").exists()


def test_a_process_killed_in_a_transfer_leaves_a_usable_channel() -> None:
    script = (
        "from cm import device\n"
        "channel = device.AxiDma.open('from_pl')\n"
        "buffers = [channel.allocate(65536) for _ in range(8)]\n"
        "for buffer in buffers: channel.submit(buffer, length=65536)\n"
        "print('under way', flush=True)\n"
        "channel.wait(None)\n"
    )
    with subprocess.Popen(["python3", "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "under way\n"
        process.kill()
        process.wait(60)
    with device.AxiDma.open("from_pl") as again:
        assert again.completions() == []

# SPDX-License-Identifier: Apache-2.0
"""The kernel modules by themselves: KUnit suites, and what a killed process leaves."""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
from pathlib import Path

import pytest
from capabilities import kernel_log
from served import PATIENCE

from cm import device

UPDATES = Path("/lib/modules", os.uname().release, "updates")
SUITES = sorted(path.stem for path in UPDATES.glob("*kunit*.ko")) + sorted(p.stem for p in UPDATES.glob("*_test.ko"))


def modprobe(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["modprobe", *arguments], capture_output=True, text=True, check=False)


@pytest.mark.needs("kunit")
def test_there_are_kunit_suites() -> None:
    assert SUITES


@dataclasses.dataclass
class Suite:
    """What a KUnit suite said of itself."""

    planned: int = 0
    passed: list[str] = dataclasses.field(default_factory=list)
    failed: list[str] = dataclasses.field(default_factory=list)
    verdict: str = ""


KUNIT = {
    *("cm_queue", "cm_request", "cm_address", "cm_engine", "cm_stop"),  # of cm_dma
    *("cm_polled", "cm_axi_intc"),  # of cm_intc
    *("cm_axidma_frame", "cm_axidma_video"),
    *("cm_icap_verdict", "cm_configport", "cm_source"),
}

SUBTEST = re.compile(r"# Subtest: (\S+)")
PLAN = re.compile(r"^\s+1\.\.(\d+)$")
CASE = re.compile(r"^\s+(not ok|ok) \d+ (?:- )?(\S+)")  # before 6.2 with a dash
VERDICT = re.compile(r"^(not ok|ok) \d+ (?:- )?(\S+)")


def ktap(log: str) -> dict[str, Suite]:
    """The suites of a kernel's log by name."""
    suites: dict[str, Suite] = {}
    suite = Suite()
    for stamped in log.splitlines():
        line = re.sub(r"^\[[ \d.]+\] ", "", stamped)
        if found := SUBTEST.search(line):
            suite = suites.setdefault(found[1], Suite())
        elif found := PLAN.match(line):
            suite.planned = int(found[1])
        elif found := CASE.match(line):
            (suite.passed if found[1] == "ok" else suite.failed).append(found[2])
        elif (found := VERDICT.match(line)) and found[2] in suites:
            suites[found[2]].verdict = found[1]
    return suites


@pytest.mark.needs("kunit")
@pytest.mark.parametrize("module", SUITES)
def test_kunit_suites_pass(module: str) -> None:
    assert modprobe("kunit", "enable=1").returncode == 0  # disabled otherwise
    seen = len(kernel_log())
    assert modprobe(module).returncode == 0
    suites = ktap(kernel_log()[seen:])
    modprobe("-r", module)
    assert set(suites) == KUNIT
    for name, suite in suites.items():
        assert (suite.verdict, suite.failed) == ("ok", []), name
        assert len(suite.passed) == suite.planned > 0, name


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
        process.wait(PATIENCE)
    with device.AxiDma.open("from_pl") as again:
        assert again.completions() == []

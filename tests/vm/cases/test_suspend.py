# SPDX-License-Identifier: Apache-2.0
"""The whole system is suspended while something is under way; the kernel's own rehearsal of it, without the sleep."""

from __future__ import annotations

import contextlib
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import plsim
import pytest

pytestmark = pytest.mark.needs("cm", "dma", "plsim", "suspend")
POWER = Path("/sys/power")
TRACING = Path("/sys/kernel/tracing")
CHANNELS: dict[str, plsim.Attributes] = {"icap": {"kind": "icap", "timeout_ms": 600_000}}
END = re.compile(r" (\d+)\.(\d{6}): device_pm_callback_end: \S+ (\S+), err=0")


def suspend() -> None:
    """All processes are frozen and all devices suspended, then it all comes back."""
    Path("/sys/module/suspend/parameters/pm_test_delay").write_text("0")
    (POWER / "pm_test").write_text("devices")
    try:
        (POWER / "state").write_text("freeze")
    finally:
        (POWER / "pm_test").write_text("none")


@contextlib.contextmanager
def callbacks() -> Iterator[None]:
    """The kernel writes down when each device is suspended and resumed, by the clock of completions."""
    if not (TRACING / "trace").exists():
        subprocess.run(["mount", "-t", "tracefs", "tracefs", TRACING], check=True)
    event = TRACING / "events/power/device_pm_callback_end/enable"
    (TRACING / "trace_clock").write_text("mono")
    (TRACING / "trace").write_text("")
    event.write_text("1")
    try:
        yield
    finally:
        event.write_text("0")


def suspended_us(name: str) -> int:
    """When a device had been suspended, CLOCK_MONOTONIC."""
    ends = END.findall((TRACING / "trace").read_text())
    _prepared, suspended, *_ = [int(seconds) * 1_000_000 + int(us) for seconds, us, there in ends if there == name]
    return suspended


def test_a_load_under_way_ends_before_its_port_is_suspended(tmp_path: Path) -> None:
    with plsim.nothing(), plsim.board(CHANNELS, {}) as engine:
        delay = engine / "icap/delay_us"
        name = engine.name.replace("cm_plsim_dma", "cm_icap")
        delay.write_text("1000000")
        with callbacks(), plsim.loading(tmp_path) as end:
            suspend()
            done = end()
        assert done.status == 0
        assert done.finished_ns // 1000 <= suspended_us(name)
        delay.write_text("0")
        with plsim.loading(tmp_path) as end:  # and the port is there again
            assert end().status == 0

# SPDX-License-Identifier: Apache-2.0
"""The machine that a run was made on, and the one CPU that all of it is pinned to."""

from __future__ import annotations

import contextlib
import os
import platform
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

PACKAGES = ("pyzmq", "protobuf", "numpy", "iceoryx2", "eclipse-zenoh")


def describe() -> dict[str, object]:
    """Processor, kernel, Python, versions of what is compared, and the load when this is called."""
    return {
        "processor": _processor(),
        "cpus": os.cpu_count(),
        "kernel": f"{platform.system()} {platform.release()}",
        "virtual": "hypervisor" in _cpuinfo(),
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "load": [round(x, 2) for x in os.getloadavg()],
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _cpuinfo() -> str:
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _processor() -> str:
    for line in _cpuinfo().splitlines():
        key, _, value = line.partition(":")
        if key.strip() in ("model name", "Hardware", "Processor"):
            return value.strip()
    return platform.machine()


@contextlib.contextmanager
def pinned() -> Iterator[int | None]:
    """Pin this process, and those that it starts, to one CPU: the last it may use. None if that is not possible.

    Two ends on two CPUs are faster or slower from one start to the next, as the scheduler places them;
    on one CPU a round trip is the processor time of both ends and two switches, every time.
    """
    before = os.sched_getaffinity(0)
    cpu = max(before)
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError:
        yield None
        return
    try:
        yield cpu
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def unpinned(cpus: set[int]) -> Iterator[None]:
    """Use these CPUs again, for what needs more than one."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cpus)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)

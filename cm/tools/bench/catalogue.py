# SPDX-License-Identifier: Apache-2.0
"""The measurements: a module for each, and the names of the results it gives."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import NamedTuple

from cm.errors import InvalidRequest
from cm.tools.bench.result import Result
from cm.tools.bench.run import Run


class Case(NamedTuple):
    """A module of `cm.tools.bench.cases`, and the names of its results.

    Its ``run(bench)`` returns a result for each, marked if it cannot be had.
    """

    module: str
    names: tuple[str, ...]


CASES = (
    Case("frame_local", ("frame_local_vs_zmq", "frame_local_vs_64b", "frame_local_vs_iceoryx2")),
    Case("frame_pl", ("frame_pl_vs_zmq", "frame_pl_vs_zenoh", "frame_pl_vs_c")),
    Case("control", ("control_vs_zmq",)),
    Case("registers", ("register_window", "register_request")),
    Case("reconfigure", ("reconfigure",)),
    Case("readback", ("readback_pass", "readback_scrub")),
    Case("fanout", ("fanout",)),
    Case("footprint", ("footprint",)),
    Case("scraping", ("scraping",)),
    Case(
        "flood",
        tuple(name + beside for name in ("flood", "flood_requests") for beside in ("", "_vs_quiet", "_vs_busy")),
    ),
    Case("sync", ("frame_sync",)),
    Case("advisor", ("advisor",)),
    Case("build", ("build_interfaces_81", "build_interfaces_1000", "build_check", "build_generate")),
    Case("rtl", ("rtl_frames", "rtl_frames_wide", "rtl_registers")),
    Case("ros2", ("ros2_publish", "ros2_trip")),
    Case("fleet", ("fleet_discovery", "fleet_status", "fleet_change", "fleet_model")),
    Case("fig4", ("fig4",)),
    Case("fig5", ("fig5",)),
)
NAMES = tuple(name for case in CASES for name in case.names)


def chosen(names: Sequence[str]) -> list[Case]:
    """The cases that give these results; all if none is named. Raises InvalidRequest."""
    unknown = [name for name in names if name not in NAMES]
    if unknown:
        raise InvalidRequest(f"no measurement {unknown[0]!r}; there are {', '.join(NAMES)}")
    return [case for case in CASES if not names or set(names) & set(case.names)]


def measure(case: Case, bench: Run) -> list[Result]:
    """Run a case."""
    found: list[Result] = import_module(f"cm.tools.bench.cases.{case.module}").run(bench)
    return found

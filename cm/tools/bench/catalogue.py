# SPDX-License-Identifier: Apache-2.0
"""The measurements: a module for each, and the names of the results it gives."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple

from cm.errors import InvalidRequest
from cm.tools.bench.result import Result, unavailable
from cm.tools.bench.run import Run


class Case(NamedTuple):
    """A module of `cm.tools.bench.cases`, and the names of its results.

    Its ``run(bench)`` returns a result for each, marked if it cannot be had. `needs` and `beside` are packages: without
    the first nothing of it can be measured, without the others not what it is measured beside.
    """

    module: str
    names: tuple[str, ...]
    needs: str = ""
    extra: str = "bench"  # which has it
    beside: tuple[str, ...] = ()

    def missing(self) -> str:
        """What is not installed of what it needs, in words; empty if nothing."""
        absent = self.needs and find_spec(self.needs) is None
        return f"not available without {self.needs}: pip install 'fpga-cm[{self.extra}]'" if absent else ""

    def missing_beside(self) -> list[str]:
        """The packages that are not installed of those beside it."""
        return [package for package in self.beside if find_spec(package) is None]


CASES = (
    Case("frame_local", ("frame_local_vs_zmq", "frame_local_vs_64b", "frame_local_vs_iceoryx2"), beside=("iceoryx2",)),
    Case("frame_pl", ("frame_pl_vs_zmq", "frame_pl_vs_zenoh", "frame_pl_vs_c"), beside=("zenoh",)),
    Case("control", ("control_vs_zmq",)),
    Case("registers", ("register_window", "register_request")),
    Case("pynq", ("pynq_transfer",)),
    Case("reconfigure", ("reconfigure",)),
    Case("readback", ("readback_pass", "readback_scrub")),
    Case("fanout", ("fanout",)),
    Case("footprint", ("footprint",)),
    Case(
        "record",
        ("record_manager", "record_recorder", "record_p99", "record_frames", "record_frames_disk"),
        needs="foxglove",
    ),
    Case(
        "flood",
        tuple(name + beside for name in ("flood", "flood_requests") for beside in ("", "_vs_quiet", "_vs_busy")),
    ),
    Case("sync", ("frame_sync",)),
    Case("advisor", ("advisor",), needs="scipy"),
    Case(
        "build",
        ("build_interfaces_81", "build_interfaces_1000", "build_check", "build_generate"),
        needs="pyslang",
        extra="build",
    ),
    Case("rtl", ("rtl_frames", "rtl_frames_wide", "rtl_registers")),
    Case("ros2", ("ros2_publish", "ros2_trip")),
    Case("fleet", ("fleet_discovery", "fleet_status", "fleet_change", "fleet_model"), needs="zenoh"),
    Case("fig4", ("fig4",)),
    Case("fig5", ("fig5",)),
)
FAILED = "failed: "
NAMES = tuple(name for case in CASES for name in case.names)


def chosen(names: Sequence[str]) -> list[Case]:
    """The cases that give these results; all if none is named. Raises InvalidRequest."""
    unknown = [name for name in names if name not in NAMES]
    if unknown:
        raise InvalidRequest(f"no measurement {unknown[0]!r}; there are {', '.join(NAMES)}")
    return [case for case in CASES if not names or set(names) & set(case.names)]


def measure(case: Case, bench: Run) -> list[Result]:
    """Run a case. Where it cannot be had, or fails, its results say why, and the others are measured all the same."""
    why, about = case.missing(), ""
    try:
        module = import_module(f"cm.tools.bench.cases.{case.module}")
        about = module.__doc__ or ""
        found: list[Result] = [] if why else module.run(bench)
    except Exception as error:  # noqa: BLE001 (what was measured before is worth more)
        why = why or f"{FAILED}{error or type(error).__name__}"
    if not why:
        return found
    return [unavailable(name, "", about, why) for name in case.names]

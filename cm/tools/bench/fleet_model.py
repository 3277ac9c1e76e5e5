# SPDX-License-Identifier: Apache-2.0
"""What a fleet of up to 10,000 boards would need, calculated from what fifty need.

Bytes and processor time grow with the number of messages; discovery at one router, and whether all boards are there at
one time, have laws of their own. What its store needs is measured (`cm.tools.bench.fleet_store`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SIZES = (50, 1_000, 10_000)
AWAY = 1e-4  # chance that a board does not answer a change
LINK = 125e6  # bytes a second of a gigabit
# A client at one router of zenoh 1.10.2 knew all tokens after 0.027, 0.10, 0.29, 0.85 and 4.9 s where there were 1, 2,
# 3, 5 and 10 thousand of them, all of one machine: about as the square.
DISCOVERY = 3.5e-8  # seconds for each token squared
SOON = 2.0  # seconds in which a client should know all boards


@dataclass(frozen=True, slots=True)
class Measured:
    """Figures of a fleet on one machine. Seconds, bytes; processor time is of one CPU."""

    boards: int
    discovery: float
    status_bytes: float
    client_per_status: float  # processor time of the client for a status
    router_per_status: float
    client_per_board: float  # of a change, for one board: three answers

    @classmethod
    def of(
        cls, count: int, discovery: float, percent: float, status: Mapping[str, Any], change: Mapping[str, Any]
    ) -> Measured:
        """From the results of `cm bench`."""
        rate = max(1e-9, float(status["statuses_per_second"]))
        return cls(
            count,
            discovery,
            float(status["bytes_of_a_status"]),
            percent / 100 / rate,
            float(status["router_percent"]) / 100 / rate,
            float(change["client_cpu_ms"]) / 1000 / count,
        )

    @property
    def statuses_of_a_cpu(self) -> float:
        """Statuses a second that a client can take with one CPU."""
        return 1 / self.client_per_status


def reckoned(m: Measured, boards: int) -> dict[str, Any]:
    """The figures for one size of fleet, with all statuses at 1 Hz."""
    found = {
        "boards": boards,
        "status_bytes_per_second": boards * m.status_bytes,
        "share_of_a_gigabit": boards * m.status_bytes / LINK,
        "client_cpus": boards * m.client_per_status,
        "one_router_cpus": boards * m.router_per_status,
        "discovery_seconds": max(m.discovery, DISCOVERY * boards**2),
        "change_client_seconds": boards * m.client_per_board,
        "all_answer": (1 - AWAY) ** boards,
    }
    return {**found, "first": _first(found)}


def _first(found: Mapping[str, Any]) -> str:
    """The figure that exceeds its bound the most."""
    over = {
        "the client's processor": found["client_cpus"],
        "one router's processor": found["one_router_cpus"],
        "the client's link": found["share_of_a_gigabit"],
        "discovery at one router": found["discovery_seconds"] / SOON,
        "policy all: somebody is always away": 0.5 / max(found["all_answer"], 1e-12),
    }
    worst = max(over, key=lambda name: over[name])
    return worst if over[worst] > 1 else "nothing"

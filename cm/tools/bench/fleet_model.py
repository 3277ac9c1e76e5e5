# SPDX-License-Identifier: Apache-2.0
"""What a fleet of up to 100,000 boards would need, calculated and simulated from what fifty need.

Calculated: bytes and processor time, which grow with the number of messages, for one router and for one router per
region of boards. Simulated: a change of all, with the time of each board drawn from measured ones, boards that are away
or fail with a given probability, and a client that handles one answer after the other.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SIZES = (50, 1_000, 10_000, 100_000)
REGION = 500  # boards to a router of their own
AWAY = 1e-4  # chance that a board does not answer a change
LINK = 125e6  # bytes a second of a gigabit
TOKEN = 80  # bytes of a token's declaration on the network, roughly: key, ids, headers
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
    client_per_board: float  # of a change, for one board: four answers
    board_load: float  # median time of a board's own change
    board_spread: float  # slowest over median

    @classmethod
    def of(
        cls, count: int, discovery: float, percent: float, status: Mapping[str, Any], change: Mapping[str, Any]
    ) -> Measured:
        """From the results of `cm bench`."""
        rate = max(1e-9, float(status["statuses_per_second"]))
        median = max(1e-6, float(change["load_of_the_median_board_ms"]) / 1000)
        return cls(
            count,
            discovery,
            float(status["bytes_of_a_status"]),
            percent / 100 / rate,
            float(status["router_percent"]) / 100 / rate,
            float(change["client_cpu_ms"]) / 1000 / count,
            median,
            max(1.0, float(change["load_of_the_slowest_board_ms"]) / 1000 / median),
        )

    @property
    def statuses_of_a_cpu(self) -> float:
        """Statuses a second that a client can take with one CPU."""
        return 1 / self.client_per_status


def reckoned(m: Measured, boards: int) -> dict[str, Any]:
    """The figures for one size of fleet, with all statuses at 1 Hz."""
    regions = max(1, math.ceil(boards / REGION))
    played = played_through(m, boards)
    found = {
        "boards": boards,
        "routers": max(1, regions),
        "status_bytes_per_second": boards * m.status_bytes,
        "share_of_a_gigabit": boards * m.status_bytes / LINK,
        "client_cpus": boards * m.client_per_status,
        "one_router_cpus": boards * m.router_per_status,
        "region_router_cpus": min(boards, REGION) * m.router_per_status,
        "tokens_bytes": boards * TOKEN,
        "discovery_seconds": max(m.discovery, DISCOVERY * boards**2),
        "change_seconds": played["median"],
        "change_seconds_99": played["p99"],
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


def played_through(m: Measured, boards: int, rounds: int = 31, seed: int = 1) -> dict[str, float]:
    """Simulate a change of all several times: seconds until the decision is known, median and 99th percentile."""
    chance = random.Random(seed)
    times = sorted(_one_change(m, boards, chance) for _ in range(rounds))
    return {"median": times[len(times) // 2], "p99": times[min(len(times) - 1, int(0.99 * len(times)))]}


def _one_change(m: Measured, boards: int, chance: random.Random) -> float:
    """Plan, prepare, apply, report: in each phase the client handles all boards, and waits for the last.

    A board's time is lognormal, with the measured median, and a width that gives the measured slowest.
    """
    width = math.log(m.board_spread) / max(1.0, _expected_most(m.boards))
    slowest = m.board_load * math.exp(width * _most(boards, chance))
    handling = boards * m.client_per_board  # all four phases together
    return handling + slowest


def _expected_most(count: int) -> float:
    """Roughly the expected largest of that many normal numbers, in standard deviations."""
    return math.sqrt(2 * math.log(max(count, 2)))


def _most(count: int, chance: random.Random) -> float:
    """The largest of that many normal numbers, drawn directly, by the inverse of its distribution."""
    from statistics import NormalDist

    uniform = max(chance.random(), 1e-12)
    return NormalDist().inv_cdf(min(1 - 1e-15, uniform ** (1 / count)))

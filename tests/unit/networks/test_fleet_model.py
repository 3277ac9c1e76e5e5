# SPDX-License-Identifier: Apache-2.0
"""The model of large fleets: it scales as expected, and says what breaks first."""

from __future__ import annotations

from cm.tools.bench.fleet_model import SIZES, Measured, played_through, reckoned

SMALL = Measured(50, 0.05, 500.0, 1e-3, 5e-4, 2e-3, 0.01, 4.0)


def test_bytes_and_processor_time_grow_with_the_number_of_boards() -> None:
    rows = [reckoned(SMALL, boards) for boards in SIZES]
    assert [row["status_bytes_per_second"] for row in rows] == [boards * 500.0 for boards in SIZES]
    assert [row["client_cpus"] for row in rows] == [boards * 1e-3 for boards in SIZES]
    assert (
        rows[-1]["region_router_cpus"] == 500 * 5e-4
    )  # a region's router does not depend on how many other regions there are


def test_a_change_takes_as_long_as_the_client_and_the_slowest_board() -> None:
    small, large = played_through(SMALL, 50), played_through(SMALL, 100_000)
    assert 50 * 2e-3 + 0.01 < small["median"] < 0.3
    assert 100_000 * 2e-3 < large["median"] < 100_000 * 2e-3 + 1
    assert played_through(SMALL, 50) == small  # the same draw each time


def test_what_breaks_first_is_named() -> None:
    assert reckoned(SMALL, 50)["first"] == "nothing"
    assert reckoned(SMALL, 10_000)["first"] == "the client's processor"
    assert reckoned(SMALL, 100_000)["first"] == "policy all: somebody is always away"
    quick = Measured(50, 0.05, 500.0, 1e-6, 5e-7, 2e-6, 0.01, 4.0)
    assert reckoned(quick, 10_000)["first"] == "discovery at one router"
